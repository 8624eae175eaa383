"""A file of which nobody reads more than there is, whatever lengths are written in it."""

from __future__ import annotations

import io
from typing import BinaryIO, cast


class BoundedFile:
    """An open file, to be read from its beginning: a damaged length asks for no memory beyond its size."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, io.SEEK_END)
        file.seek(0)

    def read(self, size: int = -1) -> bytes:
        """At most `size` bytes, and at most what is left."""
        left = max(self._size - self._file.tell(), 0)
        return self._file.read(left if size < 0 else min(size, left))

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """As files do."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """As files do."""
        return self._file.tell()

    def seekable(self) -> bool:
        """As files do."""
        return self._file.seekable()


def bounded(file: BinaryIO) -> BinaryIO:
    """`file` for libraries that trust the lengths in it."""
    return cast(BinaryIO, BoundedFile(file))
