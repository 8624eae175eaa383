"""CRC-32C (Castagnoli) in numpy: many short pieces at once, then joined two by two.

A CRC is linear, and appending zero bytes to a message is a linear map of its CRC. So the CRCs of pieces of
equal length, computed side by side, give that of the whole: shift the left one by the right one's length,
add.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_PIECE = 256
Words = NDArray[np.uint32]


def crc32c(data: bytes | memoryview) -> int:
    """CRC-32C of some bytes.

    >>> hex(crc32c(b"123456789"))
    '0xe3069283'
    """
    values = np.frombuffer(data, np.uint8)
    if len(values) < 4:
        return _short(values)
    pieces = 1 << ((len(values) - 1) // _PIECE).bit_length()
    # The usual start value is the complement of the first four bytes; zeros before those change nothing.
    padded = np.zeros(pieces * _PIECE, np.uint8)
    first = len(padded) - len(values)
    padded[first:] = values
    padded[first : first + 4] ^= 0xFF
    crc = _advance(padded.reshape(pieces, _PIECE))
    shift = _power(_ONE_BYTE, _PIECE)
    while len(crc) > 1:
        crc = _apply(shift, crc[0::2]) ^ crc[1::2]
        shift = _apply(shift, shift)
    return int(crc[0]) ^ 0xFFFFFFFF


def masked(crc: int) -> int:
    """A CRC as TFRecord files store it, so that CRCs of data with CRCs in them stay strong."""
    return (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF


def _make_table() -> Words:
    crc: Words = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        crc = (crc >> np.uint32(1)) ^ (crc & np.uint32(1)) * np.uint32(0x82F63B78)
    return crc


_TABLE = _make_table()


def _advance(rows: NDArray[np.uint8]) -> Words:
    """CRC of each row, from 0 and without final complement."""
    crc = np.zeros(len(rows), np.uint32)
    for column in np.ascontiguousarray(rows.T):
        crc = _TABLE[(crc & 0xFF) ^ column] ^ (crc >> 8)
    return crc


def _apply(operator: Words, crc: Words) -> Words:
    """A linear map, given by its images of the 32 bits, of each CRC."""
    result = np.zeros_like(crc)
    for bit in range(32):
        result ^= np.where(crc >> bit & 1, operator[bit], np.uint32(0))
    return result


def _power(operator: Words, power_of_two: int) -> Words:
    while power_of_two > 1:
        operator = _apply(operator, operator)
        power_of_two //= 2
    return operator


_BITS = np.uint32(1) << np.arange(32, dtype=np.uint32)
_ONE_BYTE = _TABLE[_BITS & 0xFF] ^ (_BITS >> 8)
"""What one zero byte does to a CRC."""


def _short(values: NDArray[np.uint8]) -> int:
    crc = 0xFFFFFFFF
    for value in values.tolist():
        crc = int(_TABLE[(crc ^ value) & 0xFF]) ^ (crc >> 8)
    return crc ^ 0xFFFFFFFF
