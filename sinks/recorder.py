"""Records the CSI that came in, in files of bounded size that replay on their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingWriter
from chachart.sinks.base import SinkSettings
from chachart.sinks.file_sink import FileSink, FileSinkSettings
from chachart.sinks.files import free_name


class RecorderSettings(FileSinkSettings):
    """`type = "recorder"`: the CSI that came in, to MCAP files that replay on their own."""

    type: Literal["recorder"] = "recorder"
    path: Path = Path("csi-{time}.mcap")
    """The file; `{time}` becomes the UTC time, and a number is added where a name is taken."""
    max_bytes: int = Field(1024**3, ge=1024**2)
    """A file that has grown so long is closed and the next one begun."""
    compression: Literal["none", "zstd"] = "none"
    """`zstd` makes files shorter, by much where samples were small whole numbers, at a cost in time."""
    flush_s: float = Field(1.0, gt=0)
    """Frames go to the operating system after so many seconds at the latest."""


class Recorder(FileSink[RecordingWriter]):
    """Writes every block. Files are never overwritten."""

    Settings: ClassVar[type[SinkSettings]] = RecorderSettings
    wants_csi = True
    settings: RecorderSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self.flush_s = self.settings.flush_s
        self.max_bytes = self.settings.max_bytes

    def on_csi(self, block: CsiBlock) -> None:
        """Write a block."""
        self._write(len(block), lambda file: file.write(block))

    def _begin(self) -> tuple[Path, RecordingWriter]:
        path = free_name(self.settings.path)
        zstd = self.settings.compression == "zstd"
        return path, RecordingWriter(path, self.array, facts=self.facts, others=self.others, zstd=zstd)
