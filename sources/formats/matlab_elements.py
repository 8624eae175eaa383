"""The elements that a MATLAB file of version 5 is made of: each a tag (type and length) and data."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.base import Variable

HEADER_BYTES = 128
MATRIX, COMPRESSED = 14, 15
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of elements that hold numbers."""
_CLASSES = {
    6: "f8",
    7: "f4",
    8: "i1",
    9: "u1",
    10: "i2",
    11: "u2",
    12: "i4",
    13: "u4",
    14: "i8",
    15: "u8",
}
"""Classes of arrays that hold numbers."""
_COMPLEX = 0x08
_DENSEST = 1100
"""Deflate makes nothing smaller than this."""


Parts = list[tuple[int, memoryview]]


@dataclass(frozen=True, slots=True)
class Array:
    """An array that has been found but not yet put together; order is that of its bytes."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    parts: Parts
    order: str

    def read(self) -> NDArray[Any]:
        """The array."""
        planes = [self._plane(kind, data) for kind, data in self.parts]
        if len(planes) == 1:
            return planes[0]
        whole = np.empty(self.shape, np.complex64 if self.dtype.name == "float32" else np.complex128)
        whole.real, whole.imag = planes
        return whole

    def variable(self) -> Variable:
        """What there is to say of it."""
        return Variable(self.shape, f"complex {self.dtype}" if len(self.parts) > 1 else str(self.dtype))

    def _plane(self, kind: int, data: memoryview) -> NDArray[Any]:
        if kind not in _TYPES:
            raise ValueError(f'"{self.name}" holds elements of type {kind}')
        stored = np.dtype(self.order + _TYPES[kind])
        if len(data) != math.prod(self.shape) * stored.itemsize:
            raise ValueError(f'"{self.name}" is {self.shape}, but holds {len(data)} bytes of {stored}')
        with np.errstate(invalid="ignore"):
            values = np.frombuffer(data, stored).astype(self.dtype)
        return values.reshape(self.shape, order="F")


def order_of(data: bytes) -> str:
    """The byte order of a file, as numpy writes it."""
    return "<" if data[126:128] == b"IM" else ">"


def matrices(data: bytes) -> Iterator[memoryview]:
    """The data of each matrix element of a file, unpacked.

    Raises
    ------
    ValueError
        Where a length does not fit.
    """
    order = order_of(data)
    for kind, element in elements(memoryview(data)[HEADER_BYTES:], order):
        if kind == COMPRESSED:
            kind, element = next(elements(inflated(element, order), order), (0, element))
        if kind == MATRIX:
            yield element


def elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and data of each element; a short one has both tag and data in eight bytes.

    Raises
    ------
    ValueError
        Where a length does not fit.
    """
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise ValueError("it ends within a tag")
        kind, length = (int(n) for n in np.frombuffer(data[at : at + 8], f"{order}u4"))
        start = at + 8
        if kind >> 16:
            kind, length, start = kind & 0xFFFF, kind >> 16, at + 4
        end = start + length
        if end > len(data) or (start == at + 4 and length > 4):
            raise ValueError(f"an element of {length} bytes does not fit")
        yield kind, data[start:end]
        # Elements begin at multiples of eight bytes; compressed ones follow each other without a gap.
        at = end if kind == COMPRESSED else start + 4 if start == at + 4 else -(-end // 8) * 8


def inflated(data: memoryview, order: str) -> memoryview:
    """The element that a compressed one holds.

    Raises
    ------
    ValueError
        If it is damaged.
    """
    inflate = zlib.decompressobj()
    try:
        tag = inflate.decompress(data, 8)
        length = int(np.frombuffer(tag, f"{order}u4")[1]) if len(tag) == 8 else 0
        if length > _DENSEST * len(data):
            raise ValueError(f"{len(data)} compressed bytes claim to be {length}")
        body = inflate.decompress(inflate.unconsumed_tail, length) if length else b""
        if len(body) == length:
            inflate.decompress(inflate.unconsumed_tail, 1)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if not inflate.eof:
        raise ValueError("compressed data end too early or too late")
    return memoryview(tag + body)


def array_in(data: memoryview, order: str, nameless: bool = False) -> Array | None:
    """The array in a matrix element; None if it is not of numbers (text, say) or has no name.

    Raises
    ------
    ValueError
        If its parts do not fit together.
    """
    parts = list(elements(data, order))
    if not parts or len(parts[0][1]) != 8:
        raise ValueError("an array without flags")
    flags = int(np.frombuffer(parts[0][1], f"{order}u4")[0])
    if flags & 0xFF not in _CLASSES:
        return None
    planes = 2 if flags >> 8 & _COMPLEX else 1
    if len(parts) != 3 + planes or len(parts[1][1]) % 4:
        raise ValueError(f"an array of {len(parts)} parts")
    shape = tuple(np.frombuffer(parts[1][1], f"{order}i4").tolist())
    name = bytes(parts[2][1]).decode("ascii", "replace")
    if min(shape, default=0) < 0:
        raise ValueError(f'"{name}" has shape {shape}')
    dtype = np.dtype(_CLASSES[flags & 0xFF])
    return Array(name, shape, dtype, parts[3:], order) if name or nameless else None


def numbers(data: memoryview, order: str) -> NDArray[Any] | None:
    """The array in a nameless matrix element, as those of cells and structs are; None if it is another.

    Raises
    ------
    ValueError
        If its parts do not fit together.
    """
    found = array_in(data, order, nameless=True)
    return None if found is None else found.read()
