"""What sinks that write files share: they rotate, survive a full disk, and say what is missing."""

from __future__ import annotations

import errno
import logging
import os
import time
from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.files import write_problems

log = logging.getLogger(__name__)

ROOM_BYTES = 1024**2
"""With less free than this, no new file is begun after a disk was full."""
_REASONS = {
    errno.ENOSPC: "disk_full",
    errno.EDQUOT: "disk_full",
    errno.EFBIG: "disk_full",
    errno.ENOENT: "folder_gone",
    errno.ENOTDIR: "folder_gone",
    errno.EROFS: "read_only",
    errno.EACCES: "read_only",
    errno.EPERM: "read_only",
}


class FileSinkSettings(SinkSettings):
    """What every sink that writes files is told."""

    path: Path
    """The file."""


class OpenFile(Protocol):
    """A file in progress. Where the disk takes no more, its methods raise OSError and leave it whole."""

    @property
    def bytes_written(self) -> int:
        """Its size."""

    @property
    def kept(self) -> int:
        """Frames, rows or reports that are in it whatever happens now."""

    def flush(self) -> None:
        """Hand on what is gathered."""

    def close(self) -> None:
        """End it, with an index where it has one."""


File = TypeVar("File", bound=OpenFile)


class FileSink(Sink, Generic[File]):
    """Keeps one file in progress; subclasses say how to begin one, and write through `_write`.

    A disk that takes no more ends the file at its last whole chunk. What is not written from then on is
    counted in `lost` by reason (`disk_full`, `folder_gone`, `read_only`, `write_failed`), `trouble` says
    why, and as soon as there is room again a new file is begun.
    """

    Settings: ClassVar[type[SinkSettings]] = FileSinkSettings
    settings: FileSinkSettings
    flush_s: float = 5.0
    """What is gathered goes to the operating system after so many seconds at the latest."""
    max_bytes: float = float("inf")
    """A file that has grown so long is ended and the next one begun."""
    retry_s: float = 2.0
    """So often it looks whether there is room again."""
    appends: bool = False
    """Whether a file may hold what was there before."""

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._file: File | None = None
        self._path: Path | None = None
        self._taken = 0
        self._reason = "closed"
        self._retry_at = self._flush_at = 0.0

    @abstractmethod
    def _begin(self) -> tuple[Path, File]:
        """A new file and where it is.

        Raises
        ------
        SetupError, OSError
            If it cannot be written; nothing is left of it then.
        """

    @classmethod
    def problems(cls, settings: FileSinkSettings) -> list[str]:
        """Whether a file can be written there."""
        return write_problems(settings.path)

    def open(self, node: NodeAccess | None) -> None:
        """Begin the first file.

        Raises
        ------
        SetupError
            If it cannot be written.
        """
        try:
            self._start()
        except OSError as error:
            path = error.filename or self.settings.path
            raise SetupError(f"cannot write {path}: {error.strerror}") from None

    def on_tick(self) -> None:
        """Hand on what is gathered now and then, so that a slow stream is not lost by the minute."""
        now = time.monotonic()
        if now >= self._flush_at:
            self._flush_at = now + self.flush_s
            self._write(0, lambda file: file.flush())

    def close(self) -> None:
        """End the file. May be called twice."""
        self._end()
        self._retry_at = float("inf")

    def where(self) -> str | None:
        """The file in progress, or the last one."""
        return None if self._path is None else str(self._path)

    def _write(self, items: int, write: Callable[[File], None]) -> None:
        """Have `items` frames, rows or reports written; count what is not."""
        file = self._ready()
        if file is None:
            if items:
                self.lost.add(self._reason, items)
            return
        self._taken += items
        try:
            write(file)
        except OSError as error:
            self._fail(error)

    def _ready(self) -> File | None:
        """The file to write to, a new one where it is time; None while there is no room for one."""
        if self._file is not None and self._file.bytes_written >= self.max_bytes:
            self._end()
            self._retry_at = 0.0
        if self._file is None and time.monotonic() >= self._retry_at:
            self._retry_at = time.monotonic() + self.retry_s
            try:
                if self.trouble is None or _room(self.settings.path.parent):
                    self._start()
            except (OSError, SetupError) as error:
                self._tell(error)
        return self._file

    def _start(self) -> None:
        self._path, self._file = self._begin()
        self._taken = 0
        self._retry_at = 0.0
        if self.trouble is not None:
            log.warning(
                "%s: writes again, to %s; %s lost until now", self.settings.type, self._path, self.lost
            )
            self.trouble = None

    def _end(self) -> None:
        """Close the file; what the disk does not take any more is counted."""
        file = self._file
        if file is not None:
            try:
                file.close()
                self._file = None
            except OSError as error:
                self._fail(error)

    def _fail(self, error: OSError) -> None:
        """Give the file up at its last whole chunk."""
        file, self._file = self._file, None
        assert file is not None
        # The disk that refused a chunk may refuse the index as well; the file is readable without.
        with suppress(OSError):
            file.close()
        if file.kept == 0 and not self.appends and self._path is not None:
            with suppress(OSError):
                self._path.unlink()
        self._retry_at = time.monotonic() + self.retry_s
        self._tell(error)
        self.lost.add(self._reason, self._taken - file.kept)

    def _tell(self, error: OSError | SetupError) -> None:
        """Say why nothing is written, once for each reason."""
        if isinstance(error, OSError):
            reason, text = _REASONS.get(error.errno or 0, "write_failed"), error.strerror or str(error)
        else:
            reason, text = "write_failed", str(error)
        if self.trouble is None or (isinstance(error, OSError) and reason != self._reason):
            self._reason, self.trouble = reason, f"{self._path} has ended: {text}"
            log.error("%s: %s; a new file is begun when there is room", self.settings.type, self.trouble)


def _room(folder: Path) -> bool:
    """Whether there is room for a new file.

    Raises
    ------
    OSError
        If the folder is gone.
    """
    state = os.statvfs(folder)
    return state.f_bavail * state.f_frsize >= ROOM_BYTES
