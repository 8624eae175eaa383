"""NumPy `.npy`: one array, which the importer knows as `array`. Pickled objects are never read."""

from __future__ import annotations

import math
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture, Variable

NAME = "NumPy .npy"

_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
    (3, 0): np.lib.format.read_array_header_2_0,
}
DAMAGE = (ValueError, EOFError, OSError, SyntaxError, TokenError)
"""What numpy raises for bytes that are no array."""


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    return None if head.startswith(b"\x93NUMPY") else "it has no NumPy header"


def open_capture(path: Path) -> Capture:
    """The array of a file.

    Raises
    ------
    SetupError
        If the file is damaged or cut short.
    """
    try:
        with path.open("rb") as file:
            variable = read_header(file, path.stat().st_size)
    except DAMAGE as error:
        raise SetupError(f"{path} is damaged or cut short: {error}") from None
    return NpyCapture(path, {"array": variable})


def read_header(stream: BinaryIO, size: int) -> Variable:
    """Shape and type from the header of an array of `size` bytes in all.

    Raises
    ------
    ValueError
        If it is no header, or the array does not have the size that it tells: checked before anybody
        allocates it.
    """
    version = np.lib.format.read_magic(stream)
    if version not in _READERS:
        raise ValueError(f"version {version[0]}.{version[1]} of the header is not known")
    shape, _, dtype = _READERS[version](stream)
    held = size - stream.tell()
    if not dtype.hasobject and math.prod(shape) * dtype.itemsize != held:
        raise ValueError(f"the header says {dtype} {shape}, but the array holds {held} bytes")
    return Variable(tuple(shape), str(dtype))


class NpyCapture(Capture):
    """An opened `.npy` file."""

    format = NAME

    def _read(self, name: str) -> NDArray[Any]:
        try:
            with self.path.open("rb") as file:
                array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
        except DAMAGE as error:
            raise self.damaged(error) from None
        return array
