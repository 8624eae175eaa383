"""Writes an MCAP file of one channel, chunk by chunk, without copying a message that is not compressed.

The `mcap` package's own writer copies every message five times on its way to the file, and that is most of
what recording costs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import zstandard
from isal.isal_zlib import crc32
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from chachart.node.data.version import build
from chachart.node.files.mcap_chunks import CHUNK, MAGIC, MESSAGE, RECORD, ZSTD
from chachart.node.files.whole_file import WholeFile

_CHANNEL = _SCHEMA = 1
ZSTD_LEVEL = 1
"""Higher ones cost much and save little of what is mostly noise."""


class OutgoingMessage(NamedTuple):
    """One message: its log and publish times (ns) and its bytes, in parts that follow each other."""

    log_ns: int
    publish_ns: int
    parts: Sequence[bytes | memoryview]


class McapWriter:
    """Writes to an empty file; closing it is the caller's.

    A chunk or record that the disk refuses leaves nothing behind, in the file or in its index.

    Parameters
    ----------
    file
        Where to.
    topic, encoding
        Of the channel: its name, and how its messages are encoded.
    schema_name, schema
        Of the messages, as text for people.
    zstd
        Whether chunks are compressed where that makes them shorter.
    """

    def __init__(
        self,
        file: WholeFile,
        topic: str,
        encoding: str,
        schema_name: str,
        schema: bytes,
        *,
        zstd: bool = False,
    ) -> None:
        self._file = file
        self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL) if zstd else None
        self._schema = _encoded(Schema(id=_SCHEMA, name=schema_name, encoding="text/plain", data=schema))
        self._channel = _encoded(
            Channel(id=_CHANNEL, topic=topic, message_encoding=encoding, metadata={}, schema_id=_SCHEMA)
        )
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._messages = 0
        self._file.write_all([MAGIC, _encoded(Header(profile="chachart", library=f"chachart {build()}"))])

    @property
    def bytes_written(self) -> int:
        """Size of the file so far."""
        return self._file.tell()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        record = _encoded(Metadata(name=name, metadata=dict(values)))
        start = self._file.tell()
        self._file.write(record)
        self._metadata.append(MetadataIndex(offset=start, length=len(record), name=name))

    def add_chunk(self, messages: Sequence[OutgoingMessage]) -> None:
        """Write messages as one chunk with its CRC-32.

        Raises
        ------
        OSError
            If the disk takes no more; the file is what it was before.
        """
        pieces: list[bytes | memoryview] = [] if self._chunks else [self._schema, self._channel]
        size = sum(map(len, pieces))
        places: list[tuple[int, int]] = []
        for message in messages:
            length = MESSAGE.size + sum(map(len, message.parts))
            head = RECORD.pack(Opcode.MESSAGE, length)
            number = (self._messages + len(places)) & 0xFFFFFFFF
            head += MESSAGE.pack(_CHANNEL, number, message.log_ns, message.publish_ns)
            places.append((message.log_ns, size))
            pieces += [head, *message.parts]
            size += RECORD.size + length
        crc = 0
        for piece in pieces:
            crc = crc32(piece, crc)
        start, end = min(places)[0], max(places)[0]
        compression, pieces, length = self._packed(pieces, size)
        head = RECORD.pack(Opcode.CHUNK, CHUNK.size + len(compression) + 8 + length)
        head += (
            CHUNK.pack(start, end, size, crc, len(compression)) + compression + length.to_bytes(8, "little")
        )
        index = _encoded(MessageIndex(_CHANNEL, places))
        position = self._file.tell()
        self._file.write_all([head, *pieces, index])
        self._messages += len(places)
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=position,
                chunk_length=len(head) + length,
                message_start_time=start,
                message_end_time=end,
                message_index_offsets={_CHANNEL: position + len(head) + length},
                message_index_length=len(index),
                compression=compression.decode(),
                compressed_size=length,
                uncompressed_size=size,
            )
        )

    def _packed(
        self, pieces: list[bytes | memoryview], size: int
    ) -> tuple[bytes, list[bytes | memoryview], int]:
        """How a chunk's content goes to the file: its compression, its pieces and their length."""
        if self._compressor is not None:
            packed = self._compressor.compress(b"".join(pieces))
            if len(packed) < size:
                return ZSTD, [packed], len(packed)
        return b"", pieces, size

    def finish(self) -> None:
        """Write the index; nothing may be written after it.

        Raises
        ------
        OSError
            If the disk takes no more; the file is what it was before.
        """
        end = _encoded(DataEnd(0))
        start = self._file.tell() + len(end)
        groups: dict[Opcode, list[bytes]] = {
            Opcode.SCHEMA: [self._schema],
            Opcode.CHANNEL: [self._channel],
            Opcode.STATISTICS: [_encoded(self._statistics())],
            Opcode.CHUNK_INDEX: [_encoded(chunk) for chunk in self._chunks],
            Opcode.METADATA_INDEX: [_encoded(metadata) for metadata in self._metadata],
        }
        summary, offsets = b"", b""
        for opcode, records in groups.items():
            group = b"".join(records)
            if group:
                offsets += _encoded(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offset_start = start + len(summary)
        footer = _encoded(Footer(start, offset_start, 0))[:-4]
        crc = crc32(summary + offsets + footer)
        self._file.write_all([end, summary, offsets, footer, crc.to_bytes(4, "little"), MAGIC])

    def _statistics(self) -> Statistics:
        return Statistics(
            message_count=self._messages,
            schema_count=1,
            channel_count=1,
            attachment_count=0,
            metadata_count=len(self._metadata),
            chunk_count=len(self._chunks),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            channel_message_counts={_CHANNEL: self._messages},
        )


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
