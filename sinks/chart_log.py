"""Charts, quality and status to MCAP files that any MCAP tool reads."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Literal, cast

import msgpack
from mcap.writer import CompressionType, Writer
from pydantic import Field

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.version import build
from chachart.node.files.chart_log import HEAD
from chachart.node.files.whole_file import WholeFile
from chachart.sinks.base import SinkSettings
from chachart.sinks.file_sink import FileSink, FileSinkSettings
from chachart.sinks.files import free_name
from chachart.sinks.gathering import Gathering
from chachart.sinks.plain import encoded, plain
from chachart.sinks.point_cloud import SCHEMA, point_cloud
from chachart.sinks.schemas import schemas

CHUNK_BYTES = 256 * 1024
ROWS_PER_MESSAGE = 256
"""Encoding a message holds up the interpreter, and the collector with it: a millisecond does no harm."""


class ChartLogSettings(FileSinkSettings):
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


class ChartLogFile:
    """One file in progress: one channel a topic, zstd chunks of 256 KiB.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """

    def __init__(self, path: Path, array: ArrayGeometry, settings: ChartLogSettings) -> None:
        self.kept = 0
        self._added = 0
        self._messages = 0
        self._refused = False
        known = schemas()
        self._encoding: dict[str, str] = dict.fromkeys(known, settings.encoding)
        self._file = WholeFile(path)
        try:
            self._writer = Writer(
                cast(BinaryIO, self._file), chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD
            )
            self._writer.start(profile="chachart", library=f"chachart {build()}")
            self._writer.add_metadata(HEAD, {"array": json.dumps(array.as_dict())})
            kinds = {kind: (f"{kind}.{array.name}", schema) for kind, schema in known.items()}
            if settings.foxglove:
                kinds["points"] = f"/chart/{array.name}/points", SCHEMA
                self._encoding["points"] = "json"  # Foxglove reads nothing else
            self._channels = {}
            for kind, (topic, schema) in kinds.items():
                text = json.dumps(schema).encode()
                number = self._writer.register_schema(schema["title"], "jsonschema", text)
                self._channels[kind] = self._writer.register_channel(topic, self._encoding[kind], number)
            self._writer.flush()
        except OSError:
            self._file.close()
            path.unlink(missing_ok=True)
            raise

    @property
    def bytes_written(self) -> int:
        """Size of the file; the chunk in progress does not count yet."""
        return self._file.tell()

    def add(self, kind: str, values: dict[str, Any], rows: int = 0) -> None:
        """Write one message, which holds so many rows.

        Raises
        ------
        OSError
            If the disk takes no more.
        """
        data = encoded(values) if self._encoding[kind] == "json" else msgpack.packb(plain(values))
        now = time.time_ns()
        self._added += rows
        self._messages += 1
        with self._counted():
            self._writer.add_message(self._channels[kind], now, data, now, self._messages)

    def flush(self) -> None:
        """End the chunk in progress, however short.

        Raises
        ------
        OSError
            If the disk takes no more.
        """
        with self._counted():
            self._writer.flush()

    def close(self) -> None:
        """Write the chunk in progress and the index, and close the file. May be called twice.

        A file that the disk did not let grow has no index, as one whose writer was killed.

        Raises
        ------
        OSError
            If the disk takes no more; the file ends with its last whole record, and can be read.
        """
        if not self._file.closed:
            with self._file:
                if not self._refused:
                    with self._counted():
                        self._writer.finish()

    @contextmanager
    def _counted(self) -> Iterator[None]:
        """What was added is kept once the file has grown: chunks go there whole."""
        size = self._file.tell()
        try:
            yield
        except OSError:
            self._refused = True  # the writer has lost its chunk and would write an empty one in its place
            raise
        finally:
            if self._file.tell() > size:
                self.kept = self._added


class ChartLog(FileSink[ChartLogFile]):
    """One channel a topic: `chart.<array>`, `quality.<array>`, `status.<array>`.

    With `foxglove`, each write of charts is also one JSON message on `/chart/<array>/points`.
    """

    Settings: ClassVar[type[SinkSettings]] = ChartLogSettings
    settings: ChartLogSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self.max_bytes = self.settings.max_bytes
        self._gathering = Gathering(self.settings.every_s)

    def on_chart(self, update: ChartUpdate) -> None:
        """Gather the update; write what is gathered when it is time."""
        self._gathering.add(update)
        self._write_chart(self._gathering.due())

    def on_quality(self, report: dict[str, Any]) -> None:
        """Write the report."""
        self._report("quality", report)

    def on_status(self, report: dict[str, Any]) -> None:
        """Write the report."""
        self._report("status", report)

    def on_tick(self) -> None:
        """Write what is gathered when it is time."""
        self._write_chart(self._gathering.due())
        super().on_tick()

    def close(self) -> None:
        """Write what is gathered, and end the file."""
        self._write_chart(self._gathering.take())
        super().close()

    def _write_chart(self, update: ChartUpdate | None) -> None:
        if update is None:
            return
        for part in update.parts(ROWS_PER_MESSAGE):
            values = part.plain()
            self._write(len(part), partial(ChartLogFile.add, kind="chart", values=values, rows=len(part)))
        if self.settings.foxglove:
            self._write(0, lambda file: file.add("points", point_cloud(update)))
        self._gathering.done()

    def _report(self, kind: str, report: dict[str, Any]) -> None:
        values = {"array": self.array.name, **report}
        self._write(0, lambda file: file.add(kind, values))

    def _begin(self) -> tuple[Path, ChartLogFile]:
        path = free_name(self.settings.path)
        return path, ChartLogFile(path, self.array, self.settings)
