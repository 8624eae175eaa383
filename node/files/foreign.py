"""What an MCAP file that is none of chachart's holds, in words."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from chachart.node.files.bounded import bounded

MOST_NAMED = 5
_MAX_RECORD_BYTES = 1 << 28


_DAMAGE = (
    McapError,
    OSError,
    ValueError,
    LookupError,
    EOFError,
    TypeError,
    MemoryError,
    ArithmeticError,
    struct.error,
)


def contents(path: Path) -> str:
    """The schemas (or topics, of channels without one) in a file; empty where none can be read."""
    try:
        names = list(dict.fromkeys(_from_summary(path) or _from_records(path)))
    except _DAMAGE:
        return ""
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def _from_summary(path: Path) -> list[str]:
    with path.open("rb") as file:
        summary = make_reader(bounded(file)).get_summary()
    if summary is None:
        return []
    schemas = {number: schema.name for number, schema in summary.schemas.items()}
    return [schemas.get(channel.schema_id) or channel.topic for channel in summary.channels.values()]


def _from_records(path: Path) -> Iterator[str]:
    """Those outside of chunks, and in chunks that are not compressed."""
    schemas: dict[int, str] = {}
    with path.open("rb") as file:
        for outer in StreamReader(
            bounded(file), emit_chunks=True, record_size_limit=_MAX_RECORD_BYTES
        ).records:
            plain = isinstance(outer, Chunk) and not outer.compression
            for record in breakup_chunk(outer) if plain and isinstance(outer, Chunk) else [outer]:
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    yield schemas.get(record.schema_id) or record.topic
