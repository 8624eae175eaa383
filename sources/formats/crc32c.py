"""CRC-32C (Castagnoli) in numpy: many short pieces at once, then joined two by two.

A CRC is linear, and appending zero bytes to a message is a linear map of its CRC. So the CRCs of pieces of
equal length, computed side by side, give that of the whole: shift the left one by the length of the right
one, and add.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

_PIECE = 128
_SHORT = 2048
"""Up to so many bytes, plain Python is faster."""

Words = NDArray[np.uint32]


def crc32c(data: bytes | memoryview) -> int:
    """CRC-32C of some bytes.

    >>> hex(crc32c(b"123456789"))
    '0xe3069283'
    """
    if len(data) <= _SHORT:
        return _one_by_one(data)
    pieces = 1 << ((len(data) - 1) // _PIECE).bit_length()
    # The usual start value is the complement of the first four bytes; zeros before those change nothing.
    padded = np.zeros(pieces * _PIECE, np.uint8)
    first = len(padded) - len(data)
    padded[first:] = np.frombuffer(data, np.uint8)
    padded[first : first + 4] ^= 0xFF
    crc = _side_by_side(padded.reshape(pieces, _PIECE))
    length = _PIECE
    while len(crc) > 1:
        crc = _shift(crc[0::2], length) ^ crc[1::2]
        length *= 2
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
_PLAIN_TABLE = _TABLE.tolist()


def _one_by_one(data: bytes | memoryview) -> int:
    crc = 0xFFFFFFFF
    for value in bytes(data):
        crc = _PLAIN_TABLE[(crc ^ value) & 0xFF] ^ (crc >> 8)
    return crc ^ 0xFFFFFFFF


def _side_by_side(rows: NDArray[np.uint8]) -> Words:
    """CRC of each row, from 0 and without final complement."""
    crc = np.zeros(len(rows), np.uint32)
    for column in np.ascontiguousarray(rows.T):
        crc = _TABLE[(crc & 0xFF) ^ column] ^ (crc >> 8)
    return crc


def _shift(crc: Words, length: int) -> Words:
    """What so many zero bytes, a power of two, do to each CRC."""
    low, second, third, high = _shifted_bytes(length)
    shifted: Words = low[crc & 0xFF] ^ second[crc >> 8 & 0xFF] ^ third[crc >> 16 & 0xFF] ^ high[crc >> 24]
    return shifted


@cache
def _shifted_bytes(length: int) -> tuple[Words, Words, Words, Words]:
    """What so many zero bytes do to a CRC of which one byte alone is set, by its value."""
    values = np.arange(256, dtype=np.uint32)
    alone = [values << np.uint32(8 * n) for n in range(4)]
    if length == 1:
        low, second, third, high = (_TABLE[crc & 0xFF] ^ (crc >> 8) for crc in alone)
    else:
        half = length // 2
        low, second, third, high = (_shift(_shift(crc, half), half) for crc in alone)
    return low, second, third, high
