"""The chunks of an MCAP file, uncompressed or with zstd, closed or cut off anywhere.

The `mcap` package reads a closed file well, but copies every message twice and reads nothing by time from a
file whose writer was killed. Here sizes are checked against the file before anything is read, every chunk
against its CRC-32, and messages are views of the chunk. What a chunk unpacks to is bounded by what it says.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Metadata

from chachart.node.data.errors import SetupError
from chachart.node.files.foreign import contents

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 512 * 1024 * 1024
MAX_UNPACKED_BYTES = 64 * 1024 * 1024
"""Chunks are written of some hundred KiB, by other tools of a few MiB."""
ZSTD = b"zstd"
MAX_SUMMARY_BYTES = 256 * 1024 * 1024
MAX_METADATA_BYTES = 16 * 1024 * 1024

RECORD = struct.Struct("<BQ")
CHUNK = struct.Struct("<QQQLL")
MESSAGE = struct.Struct("<HLQQ")
_FOOTER = struct.Struct("<BQQQL")
_CHUNK_INDEX = struct.Struct("<QQQQL")
_METADATA_INDEX = struct.Struct("<QQ")


class DamagedChunk(ValueError):
    """A chunk whose bytes are not what was written. `reason` is a short word to count it by."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


_UNREADABLE = (McapError, DamagedChunk, struct.error, UnicodeDecodeError)


class ChunkSpan(NamedTuple):
    """Where a chunk's content is in the file (bytes), and the range of its messages' log times (ns)."""

    offset: int
    length: int
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class FileIndex:
    """What an MCAP file holds: its chunks in order and its metadata by name.

    `closed` is False where the file has no intact summary: its writer was killed, or is still writing.
    """

    closed: bool
    chunks: list[ChunkSpan] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)


class Message(NamedTuple):
    """One message: its log and publish times (ns) and its bytes, a view of the chunk."""

    log_ns: int
    publish_ns: int
    data: memoryview


def read_index(path: Path) -> FileIndex:
    """The index of the MCAP file at `path`: from its summary, or record by record where it has none.

    Raises
    ------
    SetupError
        If the file cannot be read, is no MCAP file, or is compressed or not chunked.
    """
    try:
        with path.open("rb") as file:
            size = file.seek(0, io.SEEK_END)
            file.seek(0)
            start = file.read(len(MAGIC))
            if start != MAGIC:
                raise SetupError(f"{path} is not an MCAP file: it {_beginning(start)}")
            return _from_summary(path, file, size) or _walk(path, file, size)
    except OSError as error:
        raise SetupError(f"cannot read {path}: {error.strerror}") from None


def read_messages(file: BinaryIO, chunk: ChunkSpan) -> Iterator[Message]:
    """The messages of one chunk, in the order in which they were written.

    Raises
    ------
    DamagedChunk
        With reason `chunk_cut`, `chunk_crc`, `chunk_compression` or `chunk_layout`.
    """
    file.seek(chunk.offset)
    content = memoryview(file.read(chunk.length))
    if len(content) < chunk.length:
        raise DamagedChunk("chunk_cut")
    for opcode, record in _records(_chunk_records(content)):
        if opcode == Opcode.MESSAGE:
            if len(record) < MESSAGE.size:
                raise DamagedChunk("chunk_layout")
            _, _, log_ns, publish_ns = MESSAGE.unpack_from(record)
            yield Message(log_ns, publish_ns, record[MESSAGE.size :])


def _records(content: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each record."""
    position = 0
    while position < len(content):
        if len(content) - position < RECORD.size:
            raise DamagedChunk("chunk_layout")
        opcode, length = RECORD.unpack_from(content, position)
        position += RECORD.size
        if length > len(content) - position:
            raise DamagedChunk("chunk_layout")
        yield opcode, content[position : position + length]
        position += length


def _chunk_records(content: memoryview) -> memoryview:
    if len(content) < CHUNK.size + 8:
        raise DamagedChunk("chunk_layout")
    _, _, size, crc, length = CHUNK.unpack_from(content)
    start = CHUNK.size + length + 8
    compression = bytes(content[CHUNK.size : CHUNK.size + length])
    if int.from_bytes(content[start - 8 : start], "little") != len(content) - start:
        raise DamagedChunk("chunk_layout")
    if compression not in (b"", ZSTD):
        raise DamagedChunk("chunk_compression")
    records = _unpacked(content[start:], size) if compression else content[start:]
    if crc and crc32(records) != crc:
        raise DamagedChunk("chunk_crc")
    return records


def _unpacked(packed: memoryview, size: int) -> memoryview:
    """The `size` bytes that zstd packed: no more is ever unpacked."""
    if size > MAX_UNPACKED_BYTES:
        raise DamagedChunk("chunk_compression")
    try:
        unpacker = zstandard.ZstdDecompressor(max_window_size=MAX_UNPACKED_BYTES)
        records = unpacker.stream_reader(packed).read(size + 1)
    except zstandard.ZstdError:
        raise DamagedChunk("chunk_compression") from None
    if len(records) != size:
        raise DamagedChunk("chunk_compression")
    return memoryview(records)


def _from_summary(path: Path, file: BinaryIO, size: int) -> FileIndex | None:
    """The index that a closed file carries at its end, or None if there is none to be trusted."""
    tail = _FOOTER.size + len(MAGIC)
    if size < 2 * len(MAGIC) + _FOOTER.size:
        return None
    file.seek(size - tail)
    footer = file.read(tail)
    opcode, length, start, _, crc = _FOOTER.unpack_from(footer)
    if footer[_FOOTER.size :] != MAGIC or opcode != Opcode.FOOTER or length != _FOOTER.size - RECORD.size:
        return None
    if not 0 < start <= size - tail or size - tail - start > MAX_SUMMARY_BYTES:
        return None
    file.seek(start)
    summary = file.read(size - start)
    if crc and crc32(summary[: -len(MAGIC) - 4]) != crc:
        return None
    index = FileIndex(closed=True)
    try:
        for opcode, record in _records(memoryview(summary)[:-tail]):
            if opcode == Opcode.CHUNK_INDEX:
                start_ns, end_ns, offset, length, channels = _CHUNK_INDEX.unpack_from(record)
                text = io.BytesIO(record[_CHUNK_INDEX.size + channels + 8 :])
                _check_compression(path, ReadDataStream(text).read_prefixed_string())
                chunk = ChunkSpan(offset + RECORD.size, length - RECORD.size, start_ns, end_ns)
                if not (0 <= chunk.length <= MAX_CHUNK_BYTES and chunk.offset + chunk.length <= size):
                    return None
                index.chunks.append(chunk)
            elif opcode == Opcode.METADATA_INDEX:
                offset, length = _METADATA_INDEX.unpack_from(record)
                if not (RECORD.size <= length <= MAX_METADATA_BYTES and offset + length <= size):
                    return None
                file.seek(offset + RECORD.size)
                _add_metadata(index, file.read(length - RECORD.size))
    except _UNREADABLE:
        return None
    return index


def _walk(path: Path, file: BinaryIO, size: int) -> FileIndex:
    """The index of a file that was never closed: every record that is whole."""
    index = FileIndex(closed=False)
    position = len(MAGIC)
    while size - position >= RECORD.size:
        file.seek(position)
        opcode, length = RECORD.unpack(file.read(RECORD.size))
        content = position + RECORD.size
        if opcode == 0 or length > min(size - content, MAX_CHUNK_BYTES):
            break
        if opcode == Opcode.MESSAGE:
            raise SetupError(
                f"{path} is an MCAP file without chunks{_held(path)}; it needs some, uncompressed"
            )
        if opcode == Opcode.CHUNK and length >= CHUNK.size:
            start_ns, end_ns, _, _, compression = CHUNK.unpack(file.read(CHUNK.size))
            if compression:
                _check_compression(path, file.read(min(compression, 16)).decode(errors="replace"))
            index.chunks.append(ChunkSpan(content, length, start_ns, end_ns))
        elif opcode == Opcode.METADATA and length <= MAX_METADATA_BYTES:
            try:
                _add_metadata(index, file.read(length))
            except _UNREADABLE:
                break
        position = content + length
    return index


def _add_metadata(index: FileIndex, content: bytes) -> None:
    record = Metadata.read(ReadDataStream(io.BytesIO(content)))
    index.metadata[record.name] = record.metadata


def _check_compression(path: Path, compression: str) -> None:
    if compression not in ("", ZSTD.decode()):
        raise SetupError(
            f"{path} is compressed with {compression}{_held(path)}; `mcap decompress` makes it readable here"
        )


def _held(path: Path) -> str:
    found = contents(path)
    return f" (it has {found})" if found else ""


def _beginning(start: bytes) -> str:
    """What a file seems to be, from its first bytes."""
    kinds = {
        b"PK\x03\x04": "looks like a .npz or zip archive (`chachart import` reads .npz)",
        b"MATLAB": "looks like a MATLAB file (`chachart import` reads it)",
        b"\x89HDF": "looks like an HDF5 file (`chachart import` reads it)",
        b"\x93NUMPY": "looks like a .npy array (`chachart import` reads it)",
    }
    for magic, kind in kinds.items():
        if start.startswith(magic):
            return kind
    return f"begins with {start!r}" if start else "is empty"
