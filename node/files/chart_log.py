"""Chart logs: the MCAP files of the `chart_log` sink, closed or cut off anywhere."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.bounded import bounded

HEAD = "chachart.chart"
"""Name of the metadata record at the start of a chart log."""
MAX_RECORD_BYTES = 512 * 1024 * 1024
GATHERED_ROWS = 200_000

_DAMAGE = (McapError, zstandard.ZstdError, struct.error, ValueError)
_DECODE: dict[str, Callable[[bytes], Any]] = {"json": json.loads, "msgpack": msgpack.unpackb}


def is_chart_log(path: Path) -> bool:
    """Whether there is a file and it begins as a chart log does, whatever its name."""
    try:
        return _head(path) is not None
    except OSError:
        return False


class ChartLogReader:
    """Reads a chart log; what is damaged, or cut off, is left out.

    Attributes
    ----------
    array
        The array, as the log has it.
    damaged
        What `charts` and `quality` left out, by reason: `chunk`, `message`, `cut_off`.

    Raises
    ------
    SetupError
        If there is no such file, or it is no chart log.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.damaged = Counters()
        try:
            head = _head(self.path)
        except OSError as error:
            raise SetupError(f"cannot read {path}: {error.strerror}") from None
        if head is None:
            raise SetupError(f"{path} is no chart log")
        try:
            self.array = ArrayGeometry.from_dict(json.loads(head["array"]))
        except (KeyError, ValueError, TypeError, RecursionError) as error:
            raise SetupError(f"{path} does not describe its array: {error}") from None

    def charts(self) -> Iterator[ChartUpdate]:
        """The chart's updates in the order in which they were written."""
        for _, values in self._messages("chart."):
            try:
                update = ChartUpdate.from_plain(values)
            except (KeyError, TypeError, ValueError, OverflowError):
                self.damaged.add("message")
            else:
                if len(update):
                    yield update

    def chart(self) -> ChartUpdate | None:
        """The newest row of every UE; None where the log has no row."""
        return newest(self.charts())

    def quality(self) -> Iterator[dict[str, Any]]:
        """The quality reports, each with `time_ns`, when it was written."""
        for time_ns, values in self._messages("quality."):
            if isinstance(values, dict):
                yield {"time_ns": time_ns, **values}

    def _messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Time and content of the messages on topics that begin so."""
        decoders: dict[int, Callable[[bytes], Any]] = {}
        for record in _records(self.path, self.damaged):
            if isinstance(record, Channel) and record.topic.startswith(topic):
                if record.message_encoding in _DECODE:
                    decoders[record.id] = _DECODE[record.message_encoding]
            elif isinstance(record, Message) and record.channel_id in decoders:
                try:
                    values = decoders[record.channel_id](record.data)
                except (ValueError, msgpack.UnpackException, RecursionError):
                    self.damaged.add("message")
                else:
                    yield record.log_time, values


def newest(updates: Iterable[ChartUpdate]) -> ChartUpdate | None:
    """The last row of every UE; None where there is no row."""
    gathered: list[ChartUpdate] = []
    rows = 0
    for update in updates:
        gathered.append(update)
        rows += len(update)
        if rows > GATHERED_ROWS + 2 * len(gathered[0]):
            gathered, rows = [ChartUpdate.concatenate(gathered)], 0
    return ChartUpdate.concatenate(gathered) if gathered else None


def _head(path: Path) -> dict[str, str] | None:
    for record in _records(path, Counters()):
        if isinstance(record, Metadata):
            return dict(record.metadata) if record.name == HEAD else None
        if isinstance(record, Message):
            break
    return None


def _records(path: Path, damaged: Counters) -> Iterator[McapRecord]:
    """The records of the file and of its chunks, as far as it goes."""
    with path.open("rb") as file:
        try:
            for record in StreamReader(
                bounded(file), emit_chunks=True, record_size_limit=MAX_RECORD_BYTES
            ).records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    held = breakup_chunk(record, validate_crc=True)
                except _DAMAGE:
                    damaged.add("chunk")
                    continue
                yield from held
        except _DAMAGE:
            damaged.add("cut_off")
