"""A file that grows by whole records: where the disk refuses one, nothing of it is left behind."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

_MOST_PIECES = 512
"""What one call of the system takes; the least that POSIX promises is 16, Linux takes 1024."""


class WholeFile:
    """Unbuffered: what was written is the operating system's.

    Parameters
    ----------
    path
        The file.
    append
        Whether to go on with a file that is there; else it must not exist, not even as a link.

    Raises
    ------
    OSError
        If it cannot be opened.
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        self.path = path
        how = os.O_APPEND if append else os.O_EXCL
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | how, 0o666)
        self._size = os.fstat(self._fd).st_size
        self.closed = False

    def write(self, data: bytes | memoryview) -> int:
        """Append all of `data`, or nothing; how much that is.

        Raises
        ------
        OSError
            If the disk takes no more, or the file has been removed.
        """
        return self.write_all([data])

    def write_all(self, pieces: Sequence[bytes | memoryview]) -> int:
        """Append all pieces, one after the other, or nothing; how much that is.

        Raises
        ------
        OSError
            If the disk takes no more, or the file has been removed.
        """
        if os.fstat(self._fd).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, "it has been removed", str(self.path))
        left = [view for piece in pieces if (view := memoryview(piece).cast("B")).nbytes]
        begin = self._size
        try:
            while left:
                written = os.writev(self._fd, left[:_MOST_PIECES])
                self._size += written
                while left and written >= left[0].nbytes:
                    written -= left.pop(0).nbytes
                if written:
                    left[0] = left[0][written:]
        except OSError:
            os.ftruncate(self._fd, begin)
            os.lseek(self._fd, begin, os.SEEK_SET)
            self._size = begin
            raise
        return self._size - begin

    def tell(self) -> int:
        """Size of the file, where the next piece goes."""
        return self._size

    def flush(self) -> None:
        """Nothing waits; here for those who expect a file to have it."""

    def close(self) -> None:
        """Close the file. May be called twice."""
        if not self.closed:
            self.closed = True
            os.close(self._fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
