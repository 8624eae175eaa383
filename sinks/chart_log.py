"""Charts, quality and status to MCAP files that any MCAP tool reads."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Literal

import msgpack
from mcap.writer import CompressionType, Writer
from pydantic import Field

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.columns import COLUMNS, Column
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.chart_log import HEAD
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.files import free_name, write_problems
from chachart.sinks.foxglove import SCHEMA, point_cloud
from chachart.sinks.plain import plain

CHUNK_BYTES = 256 * 1024
FLUSH_S = 5.0
ROWS_PER_MESSAGE = 256
"""Encoding a message holds up the interpreter, and the collector with it: a millisecond does no harm."""
MOST_WAITING = 64
LARGEST_SHARE = 0.1
"""Writing charts may take such a share of the time; with very many UEs they are written less often."""

_NUMBER = {"type": ["number", "null"]}


class ChartLogSettings(SinkSettings):
    """`type = "chart_log"`: charts, quality and status to MCAP files."""

    type: Literal["chart_log"] = "chart_log"
    path: Path = Path("chart-{time}.mcap")
    """The file; `{time}` becomes the UTC time, and a number is added where a name is taken."""
    encoding: Literal["json", "msgpack"] = "json"
    """How messages are written; MCAP tools show JSON, msgpack is shorter."""
    foxglove: bool = False
    """Charts also as point clouds, which the 3D panel of Foxglove draws; makes files two thirds longer."""
    every_s: float = Field(1.0, ge=0)
    """Charts are gathered for so long, a UE is written once with its newest place; 0 writes every update."""
    max_bytes: int = Field(256 * 1024**2, ge=1024**2)
    """A file that has grown so long is closed and the next one begun."""


class ChartLog(Sink):
    """One channel a topic: `chart.<array>`, `quality.<array>`, `status.<array>`; zstd chunks of 256 KiB.

    With `foxglove`, each write of charts is also one JSON message on `/chart/<array>/points`.
    """

    Settings: ClassVar[type[SinkSettings]] = ChartLogSettings
    settings: ChartLogSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._file: BinaryIO | None = None
        self._path: Path | None = None
        self._waiting: list[ChartUpdate] = []
        self._write_at = self._flush_at = 0.0

    @classmethod
    def problems(cls, settings: ChartLogSettings) -> list[str]:
        """Whether a file can be written there."""
        return write_problems(settings.path)

    def open(self, node: NodeAccess | None) -> None:
        """Begin the first file.

        Raises
        ------
        SetupError
            If it cannot be written.
        """
        self._begin()

    def on_chart(self, update: ChartUpdate) -> None:
        """Gather the update; write what is gathered when it is time."""
        self._waiting.append(update)
        if len(self._waiting) > MOST_WAITING:
            self._waiting = [ChartUpdate.concatenate(self._waiting)]
        if time.monotonic() >= self._write_at:
            self._write_waiting()

    def on_quality(self, report: dict[str, Any]) -> None:
        """Write the report."""
        self._write("quality", {"array": self.array.name, **plain(report)})

    def on_status(self, report: dict[str, Any]) -> None:
        """Write the report."""
        self._write("status", {"array": self.array.name, **plain(report)})

    def on_tick(self) -> None:
        """Write what is gathered when it is time, and a chunk now and then, however short."""
        now = time.monotonic()
        if now >= self._write_at:
            self._write_waiting()
        if now >= self._flush_at and self._file is not None:
            self._flush_at = now + FLUSH_S
            self._writer.flush()

    def close(self) -> None:
        """Write what is gathered and the index, and close the file."""
        try:
            self._write_waiting()
        finally:
            self._end()

    def where(self) -> str | None:
        """The file in progress, or the last one."""
        return None if self._path is None else str(self._path)

    def _write_waiting(self) -> None:
        if not self._waiting:
            return
        update, self._waiting = ChartUpdate.concatenate(self._waiting), []
        begin = time.monotonic()
        for part in update.parts(ROWS_PER_MESSAGE):
            self._write("chart", part.plain())
        if self.settings.foxglove:
            self._write("points", point_cloud(update))
        if self.settings.every_s:
            took = time.monotonic() - begin
            self._write_at = begin + max(self.settings.every_s, took / LARGEST_SHARE)

    def _write(self, kind: str, values: dict[str, Any]) -> None:
        if self._file is None:
            raise OSError(f"the log {self._path} has ended")
        if self._file.tell() >= self.settings.max_bytes:
            self._end()
            self._begin()
        text = self._encoding(kind) == "json"
        data = json.dumps(values).encode() if text else msgpack.packb(values)
        now = time.time_ns()
        self._writer.add_message(self._channels[kind], now, data, now, self._written)
        self._written += 1
        self._file.flush()

    def _begin(self) -> None:
        self._path = free_name(self.settings.path)
        try:
            self._file = self._path.open("xb")
        except OSError as error:
            raise SetupError(f"cannot write {self._path}: {error.strerror}") from None
        self._written = 0
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="chachart")
        self._writer.add_metadata(HEAD, {"array": json.dumps(self.array.as_dict())})
        self._channels = {}
        kinds = {kind: (f"{kind}.{self.array.name}", schema) for kind, schema in _schemas().items()}
        if self.settings.foxglove:
            kinds["points"] = f"/chart/{self.array.name}/points", SCHEMA
        for kind, (topic, schema) in kinds.items():
            number = self._writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            self._channels[kind] = self._writer.register_channel(topic, self._encoding(kind), number)

    def _encoding(self, kind: str) -> str:
        """Foxglove reads point clouds in JSON only."""
        return "json" if kind == "points" else self.settings.encoding

    def _end(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            with file:
                self._writer.finish()


def _schemas() -> dict[str, dict[str, Any]]:
    """The JSON schema of each kind of message."""
    method = {"type": "object", "properties": {"theta": {"type": "string"}, "rho": {"type": "string"}}}
    chart = {
        "title": "chachart.chart",
        "description": "One row a UE; null where a value is unknown.",
        "type": "object",
        "properties": {
            "array": {"type": "string"},
            "method": method,
            **{column.name: _schema(column) for column in COLUMNS.values()},
        },
        "required": ["array", "method", *(c.name for c in COLUMNS.values() if not c.optional)],
    }
    quality, status = ({"title": f"chachart.{kind}", "type": "object"} for kind in ("quality", "status"))
    return {"chart": chart, "quality": quality, "status": status}


def _schema(column: Column) -> dict[str, Any]:
    row = {"type": "array", "items": _NUMBER} if column.parts else _NUMBER
    unit = f" In {column.unit}." if column.unit else ""
    return {"type": "array", "items": row, "description": f"{column.about}{unit}"}
