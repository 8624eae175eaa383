"""How long frames take, as a histogram with logarithmic buckets. Not thread-safe: one thread adds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

LOWEST_S = 1e-5
PER_DECADE = 40
DECADES = 8
BOUNDS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""The buckets that monitoring gets."""


class Latency:
    """Percentiles to within 6 %.

    >>> latency = Latency()
    >>> latency.add(0.004, frames=64)
    >>> round(latency.percentile(50), 3)
    0.004
    """

    def __init__(self) -> None:
        self._counts = np.zeros(PER_DECADE * DECADES + 1, np.int64)
        self._sum_s = 0.0
        self._upper = LOWEST_S * 10 ** (np.arange(len(self._counts)) / PER_DECADE)

    def add(self, seconds: float, frames: int) -> None:
        """So many frames took so long."""
        bucket = math.ceil(math.log10(max(seconds, LOWEST_S) / LOWEST_S) * PER_DECADE)
        self._counts[min(bucket, len(self._counts) - 1)] += frames
        self._sum_s += seconds * frames

    def percentile(self, percent: float) -> float | None:
        """Seconds within which that share of frames was done; None if there were none."""
        total = self._counts.sum()
        if not total:
            return None
        rank = np.searchsorted(np.cumsum(self._counts), total * percent / 100)
        return float(self._upper[min(rank, len(self._upper) - 1)] * 10 ** (-0.5 / PER_DECADE))

    def percentiles_ms(self) -> dict[str, float | None]:
        """p50, p99 and p99.9 in milliseconds."""
        values = {"p50": self.percentile(50), "p99": self.percentile(99), "p99_9": self.percentile(99.9)}
        return {name: None if v is None else round(v * 1e3, 3) for name, v in values.items()}

    def histogram(self) -> dict[str, Any]:
        """Cumulative counts up to each of `BOUNDS_S` as monitoring has them, all frames, and their sum."""
        within = np.searchsorted(self._upper, BOUNDS_S, side="right")
        cumulative = np.concatenate([[0], np.cumsum(self._counts)])
        return {
            "le_s": list(BOUNDS_S),
            "frames": cumulative[within].tolist(),
            "total": int(cumulative[-1]),
            "sum_s": self._sum_s,
        }
