"""Files of records, each with its length in front: where they are, with runs of like ones found at once."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_RUN = 8
"""After so many records of one length, or of two that take turns, a longer run is looked for."""


class Head(NamedTuple):
    """The head of a record: how many bytes, where in it the length stands, and what lengths there are.

    The length counts what follows the head, less `extra`.
    """

    size: int
    at: int
    bytes: int
    big_endian: bool
    least: int = 1
    most: int = 1 << 31
    extra: int = 0


class Walk(NamedTuple):
    """Where each record's data begin and how long they are, and what came of the end.

    `cut` says that the last record ends beyond the file; `broken` counts places where no length made sense.
    """

    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    cut: bool
    broken: int


def walk(
    data: NDArray[np.uint8],
    head: Head,
    plausible: Callable[[NDArray[np.int64]], NDArray[np.bool_]],
    at: int = 0,
) -> Walk:
    """The records of a file, each of a head that tells the length of what follows it.

    Where a length makes no sense (it is not in `head.least` to `head.most`, or reaches beyond the end
    although records follow that are whole), the walk goes on at the next place that looks like a record.

    Parameters
    ----------
    data
        uint8 (N,).
    plausible
        Which of these places (of heads' first bytes) look like a whole record; only asked of damaged files.
    at
        Where the first record begins.
    """
    view = np.ascontiguousarray(data).data
    number = struct.Struct((">" if head.big_endian else "<") + {2: "H", 4: "I"}[head.bytes]).unpack_from
    size, prefix, low = len(data), head.size, head.at
    least, most, extra = head.least, head.most, head.extra
    starts: list[int] = []
    lengths: list[int] = []
    runs: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
    good: NDArray[np.int64] | None = None
    cut, broken, same, last, before = False, 0, 0, -1, -1
    while at + prefix <= size:
        length = number(view, at + low)[0] + extra
        start = at + prefix
        if not least <= length <= most or start + length > size:
            if good is None:
                good = _good(data, at, plausible)
            after = int(np.searchsorted(good, at, side="right"))
            if after < len(good):
                broken += 1
                at = int(good[after])
                continue
            cut = bool(data[at:].any())
            at = size
            break
        starts.append(start)
        lengths.append(length)
        at = start + length
        if length != before:
            same = 0
        else:
            same += 1
        before, last = last, length
        if same >= _RUN:
            same = 0
            count = _run(data, at, head, (before, last))
            if count:
                step = before + last + 2 * prefix
                first = at + prefix + np.arange(count, dtype=np.int64) * step
                runs.append((np.array(starts, np.int64), np.array(lengths, np.int64)))
                pairs = np.column_stack([first, first + before + prefix]).ravel()
                runs.append((pairs, np.tile(np.array([before, last], np.int64), count)))
                starts, lengths = [], []
                at += count * step
    if at < size:
        cut = cut or bool(data[at:].any())
    runs.append((np.array(starts, np.int64), np.array(lengths, np.int64)))
    return Walk(np.concatenate([r[0] for r in runs]), np.concatenate([r[1] for r in runs]), cut, broken)


def _run(data: NDArray[np.uint8], at: int, head: Head, pair: tuple[int, int]) -> int:
    """How many pairs of records from `at` on have these two lengths, one after the other."""
    low, high = head.at, head.at + head.bytes
    second = head.size + pair[0]
    step = second + head.size + pair[1]
    count = (len(data) - at) // step
    # The two records before have these lengths.
    first_told = data[at - step + low : at - step + high]
    second_told = data[at - step + second + low : at - step + second + high]
    found, tried = 0, 64
    while found < count:
        tried = min(tried, count - found)
        block = data[at + found * step : at + (found + tried) * step].reshape(tried, step)
        same = (block[:, low:high] == first_told).all(axis=1)
        same &= (block[:, second + low : second + high] == second_told).all(axis=1)
        if not same.all():
            return found + int(np.argmin(same))
        found, tried = found + tried, tried * 4
    return found


def _good(
    data: NDArray[np.uint8], at: int, plausible: Callable[[NDArray[np.int64]], NDArray[np.bool_]]
) -> NDArray[np.int64]:
    """Places from `at` on that look like the beginning of a record."""
    places: list[NDArray[np.int64]] = []
    for first in range(at, len(data), 1 << 16):
        block = np.arange(first, min(first + (1 << 16), len(data)), dtype=np.int64)
        places.append(block[plausible(block)])
    return np.concatenate(places) if places else np.zeros(0, np.int64)
