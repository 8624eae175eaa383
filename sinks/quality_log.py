"""Quality reports as lines of JSON, one a report, appended to a file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, ClassVar, Literal

from chachart.node.files.whole_file import WholeFile
from chachart.sinks.base import SinkSettings
from chachart.sinks.file_sink import FileSink, FileSinkSettings
from chachart.sinks.files import file_name
from chachart.sinks.plain import encoded


class QualityLogSettings(FileSinkSettings):
    """`type = "quality_log"`: TW, CT, stress and position error as JSON lines."""

    type: Literal["quality_log"] = "quality_log"
    path: Path = Path("quality.jsonl")
    """The file to append to; `{time}` becomes the time of the start."""


class Lines:
    """A text file that whole lines are appended to."""

    def __init__(self, path: Path) -> None:
        self._file = WholeFile(path, append=True)
        self.kept = 0

    @property
    def bytes_written(self) -> int:
        """Size of the file."""
        return self._file.tell()

    def add(self, line: str) -> None:
        """Append a line.

        Raises
        ------
        OSError
            If the disk takes no more.
        """
        self._file.write(f"{line}\n".encode())
        self.kept += 1

    def flush(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class QualityLog(FileSink[Lines]):
    """Appends `{"time_ns", "array", ...report}` for each report and hands it to the system at once."""

    Settings: ClassVar[type[SinkSettings]] = QualityLogSettings
    settings: QualityLogSettings
    appends = True

    def on_quality(self, report: dict[str, Any]) -> None:
        """Append the report."""
        line = encoded({"time_ns": time.time_ns(), "array": self.array.name, **report}).decode()
        self._write(1, lambda file: file.add(line))

    def _begin(self) -> tuple[Path, Lines]:
        path = file_name(self.settings.path)
        return path, Lines(path)
