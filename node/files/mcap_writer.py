"""Writes an uncompressed MCAP file of one channel, chunk by chunk, without copying a message.

The `mcap` package's own writer copies every message five times on its way to the file, and that is most of
what recording costs.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from typing import BinaryIO, NamedTuple

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
from chachart.node.files.mcap_chunks import CHUNK, MAGIC, MESSAGE, RECORD

_CHANNEL = _SCHEMA = 1


class OutgoingMessage(NamedTuple):
    """One message: its log and publish times (ns) and its bytes, in parts that follow each other."""

    log_ns: int
    publish_ns: int
    parts: Sequence[bytes | memoryview]


class McapWriter:
    """Writes to an open binary file from its beginning; closing the file is the caller's.

    Parameters
    ----------
    file
        Where to.
    topic, encoding
        Of the channel: its name, and how its messages are encoded.
    schema_name, schema
        Of the messages, as text for people.
    """

    def __init__(self, file: BinaryIO, topic: str, encoding: str, schema_name: str, schema: bytes) -> None:
        self._file = file
        self._position = 0
        self._schema = _encoded(Schema(id=_SCHEMA, name=schema_name, encoding="text/plain", data=schema))
        self._channel = _encoded(
            Channel(id=_CHANNEL, topic=topic, message_encoding=encoding, metadata={}, schema_id=_SCHEMA)
        )
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._messages = 0
        self._write([MAGIC, _encoded(Header(profile="chachart", library=f"chachart {build()}"))])

    @property
    def bytes_written(self) -> int:
        """Size of the file so far."""
        return self._position

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        record = _encoded(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=self._position, length=len(record), name=name))
        self._write([record])

    def add_chunk(self, messages: Sequence[OutgoingMessage]) -> None:
        """Write messages as one chunk with its CRC-32, and hand it to the operating system."""
        pieces: list[bytes | memoryview] = [] if self._chunks else [self._schema, self._channel]
        size = sum(map(len, pieces))
        places = []
        for message in messages:
            length = MESSAGE.size + sum(map(len, message.parts))
            head = RECORD.pack(Opcode.MESSAGE, length)
            head += MESSAGE.pack(_CHANNEL, self._messages & 0xFFFFFFFF, message.log_ns, message.publish_ns)
            places.append((message.log_ns, size))
            pieces += [head, *message.parts]
            size += RECORD.size + length
            self._messages += 1
        crc = 0
        for piece in pieces:
            crc = zlib.crc32(piece, crc)
        start, end = min(places)[0], max(places)[0]
        head = RECORD.pack(Opcode.CHUNK, CHUNK.size + 8 + size)
        head += CHUNK.pack(start, end, size, crc, 0) + size.to_bytes(8, "little")
        index = _encoded(MessageIndex(_CHANNEL, places))
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=self._position,
                chunk_length=len(head) + size,
                message_start_time=start,
                message_end_time=end,
                message_index_offsets={_CHANNEL: self._position + len(head) + size},
                message_index_length=len(index),
                compression="",
                compressed_size=size,
                uncompressed_size=size,
            )
        )
        self._write([head, *pieces, index])

    def finish(self) -> None:
        """Write the index; nothing may be written after it."""
        self._write([_encoded(DataEnd(0))])
        start = self._position
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
        crc = zlib.crc32(summary + offsets + footer)
        self._write([summary, offsets, footer, crc.to_bytes(4, "little"), MAGIC])

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

    def _write(self, pieces: Sequence[bytes | memoryview]) -> None:
        for piece in pieces:
            self._file.write(piece)
        self._file.flush()
        self._position += sum(map(len, pieces))


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
