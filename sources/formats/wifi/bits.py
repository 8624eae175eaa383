"""Signed numbers of 8, 10 and 16 bits; those of 8 and 10 are packed across bytes, lowest bit first."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_WORD_BYTES = 8


def words(rows: NDArray[np.uint8], offsets: NDArray[np.int64]) -> NDArray[np.uint64]:
    """uint64 (F, W) of the eight bytes from each of W byte offsets of rows (F, L), zeros behind their end."""
    frames, length = rows.shape
    room = max(int(offsets.max()) + _WORD_BYTES, length)
    if room > length or not rows.flags.c_contiguous:
        padded = np.zeros((frames, room), np.uint8)
        padded[:, :length] = rows
        rows = padded
    found = np.empty((frames, len(offsets)), np.uint64)
    for n, offset in enumerate(offsets.tolist()):
        found[:, n] = rows[:, offset : offset + _WORD_BYTES].view("<u8")[:, 0]
    return found


def pairs_of_8(rows: NDArray[np.uint8], groups: int, gap: int, pairs: int) -> NDArray[np.int8]:
    """int8 (F, groups, pairs, 2): in each group `gap` unused bits, then pairs of 8-bit numbers."""
    numbers = 2 * pairs
    each = -(-numbers // 7)  # seven bytes and a shift of up to seven bits fit in a word
    bit = (np.arange(groups) * (gap + 8 * numbers) + gap)[:, None] + 56 * np.arange(each)
    found = words(rows, (bit // 8).ravel())
    found >>= (bit % 8).ravel().astype(np.uint64)
    octets = found.view(np.int8).reshape(len(rows), groups, each, _WORD_BYTES)[..., :7]
    flat = octets if each == 1 else octets.reshape(len(rows), groups, 7 * each)
    return flat.reshape(len(rows), groups, 7 * each)[..., :numbers].reshape(len(rows), groups, pairs, 2)


def imaginary_first_of_10(rows: NDArray[np.uint8], count: int) -> NDArray[np.complex64]:
    """complex64 (F, count) of imaginary and real part in 10 bits each; `count` is even."""
    frames, fives = len(rows), count // 2
    padded = np.zeros((frames, 5 * fives + 3), np.uint8)
    padded[:, : 5 * fives] = rows[:, : 5 * fives]
    first = padded[:, :8].view("<u8")
    packed = np.lib.stride_tricks.as_strided(first, (frames, fives), (padded.strides[0], 5)).copy()
    numbers = np.empty((frames, fives, 4), np.float32)
    for n in range(4):
        numbers[..., n ^ 1] = (packed << np.uint64(54 - 10 * n)).view(np.int64) >> 54
    return numbers.view(np.complex64).reshape(frames, count)


def complex_of_16(rows: NDArray[Any], imaginary_first: bool = False) -> NDArray[np.complex64]:
    """complex64 (F, n) of rows of bytes (or words) with real and imaginary part in 16 bits each."""
    parts = np.ascontiguousarray(rows).view("<i2")
    if not imaginary_first:
        return parts.astype(np.float32).view(np.complex64)
    values = np.empty((len(parts), parts.shape[1] // 2), np.complex64)
    values.real, values.imag = parts[:, 1::2], parts[:, ::2]
    return values
