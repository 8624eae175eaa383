"""Quality reports as lines of JSON, one a report, appended to a file."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any, ClassVar, Literal, TextIO

from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.files import file_name, write_problems
from chachart.sinks.plain import plain


class QualityLogSettings(SinkSettings):
    """`type = "quality_log"`: TW, CT, stress and position error as JSON lines."""

    type: Literal["quality_log"] = "quality_log"
    path: Path = Path("quality.jsonl")
    """The file to append to; `{time}` becomes the time of the start."""


class QualityLog(Sink):
    """Appends `{"time_ns", "array", ...report}` for each report and hands it to the system at once."""

    Settings: ClassVar[type[SinkSettings]] = QualityLogSettings
    settings: QualityLogSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._file: TextIO | None = None
        self._path: Path | None = None

    @classmethod
    def problems(cls, settings: QualityLogSettings) -> list[str]:
        """Whether the file can be written."""
        return write_problems(settings.path)

    def open(self, node: NodeAccess | None) -> None:
        """Open the file.

        Raises
        ------
        SetupError
            If it cannot be written.
        """
        self._path = file_name(self.settings.path)
        try:
            self._file = self._path.open("a", encoding="utf-8", buffering=1)
        except OSError as error:
            raise SetupError(f"cannot write {self._path}: {error.strerror}") from None

    def on_quality(self, report: dict[str, Any]) -> None:
        """Append the report."""
        if self._file is not None:
            line = {"time_ns": time.time_ns(), "array": self.array.name, **plain(report)}
            self._file.write(json.dumps(line) + "\n")

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def where(self) -> str | None:
        """The file."""
        return None if self._path is None else str(self._path)
