"""Records the CSI that came in, in files of bounded size that replay on their own."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingWriter
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.files import free_name, write_problems


class RecorderSettings(SinkSettings):
    """`type = "recorder"`: the CSI that came in, to MCAP files that replay on their own."""

    type: Literal["recorder"] = "recorder"
    path: Path = Path("csi-{time}.mcap")
    """The file; `{time}` becomes the UTC time, and a number is added where a name is taken."""
    max_bytes: int = Field(1024**3, ge=1024**2)
    """A file that has grown so long is closed and the next one begun."""
    flush_s: float = Field(1.0, gt=0)
    """Frames go to the operating system after so many seconds at the latest."""


class Recorder(Sink):
    """Writes every block. Files are never overwritten.

    A disk that takes no more ends the recording: the error is raised for that block and each later one, so
    that whoever counts errors counts what is missing, and what is in the file stays readable.
    """

    Settings: ClassVar[type[SinkSettings]] = RecorderSettings
    wants_csi = True
    settings: RecorderSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._writer: RecordingWriter | None = None
        self._path: Path | None = None
        self._failure: str | None = None
        self._flush_at = 0.0

    @classmethod
    def problems(cls, settings: RecorderSettings) -> list[str]:
        """Whether a file can be written there."""
        return write_problems(settings.path)

    def open(self, node: NodeAccess | None) -> None:
        """Begin the first file.

        Raises
        ------
        SetupError
            If it cannot be written.
        """
        self._writer = self._begin()

    def on_csi(self, block: CsiBlock) -> None:
        """Write a block.

        Raises
        ------
        OSError
            If the disk takes no more, now or before.
        """
        if self._writer is None:
            raise OSError(self._failure or "the recorder is closed")
        try:
            if self._writer.bytes_written >= self.settings.max_bytes:
                self._writer.close()
                self._writer = self._begin()
            self._writer.write(block)
        except (OSError, SetupError) as error:
            self._give_up(error)

    def on_tick(self) -> None:
        """Flush now and then, so that a slow stream is not lost by the minute."""
        if self._writer is None or time.monotonic() < self._flush_at:
            return
        self._flush_at = time.monotonic() + self.settings.flush_s
        try:
            self._writer.flush()
        except OSError as error:
            self._give_up(error)

    def close(self) -> None:
        """Close the file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def where(self) -> str | None:
        """The file in progress, or the last one."""
        return None if self._path is None else str(self._path)

    def _begin(self) -> RecordingWriter:
        self._path = free_name(self.settings.path)
        return RecordingWriter(self._path, self.array)

    def _give_up(self, error: OSError | SetupError) -> None:
        self._failure = f"the recording {self._path} has ended: {getattr(error, 'strerror', None) or error}"
        writer, self._writer = self._writer, None
        if writer is not None:
            # The disk that refused the block refuses the index as well; the file is readable without.
            with contextlib.suppress(OSError):
                writer.close()
        raise OSError(self._failure) from error
