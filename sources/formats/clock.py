"""Counters that wrap around, as clocks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def unwrapped(clock: NDArray[Any], bits: int) -> NDArray[np.int64]:
    """A counter of `bits` bits as one that does not wrap; a step back stays a step back.

    >>> unwrapped(np.array([250, 3, 1], np.uint8), bits=8).tolist()
    [250, 259, 257]
    """
    counts: NDArray[np.int64] = clock.astype(np.int64)
    half = np.int64(1 << (bits - 1))
    steps = (np.diff(counts) + half) % (2 * half) - half
    return np.concatenate([counts[:1], counts[:1] + np.cumsum(steps)])
