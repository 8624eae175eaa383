"""The last minutes of the chart, within so many bytes, for whoever wants to look back."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from chachart.node.data.chart import ChartUpdate

STEP_S = 1.0
WINDOW_S = 60.0
"""A chart of the past holds the UEs that were heard so long before."""


class History:
    """Keeps one merged update a second; the oldest make room. Thread-safe.

    Parameters
    ----------
    max_bytes
        Of all that is kept; 0 keeps nothing.
    monotonic
        The host's clock, in seconds.
    """

    def __init__(self, max_bytes: int, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._max_bytes = max_bytes
        self._monotonic = monotonic
        self._kept: deque[tuple[float, ChartUpdate, int]] = deque()
        self._bytes = 0
        self._gathered: list[ChartUpdate] = []
        self._until = 0.0
        self._lock = threading.Lock()

    def take(self, update: ChartUpdate) -> None:
        """Estimates came in."""
        if not self._max_bytes:
            return
        now = self._monotonic()
        with self._lock:
            if not self._gathered:
                self._until = now + STEP_S
            self._gathered.append(update)
            if now >= self._until:
                self._keep(now)

    def seconds(self) -> float:
        """How far back it goes."""
        with self._lock:
            return self._monotonic() - self._kept[0][0] if self._kept else 0.0

    def at(self, ago_s: float) -> ChartUpdate | None:
        """The chart as it was so many seconds ago; None where nothing is known of that time."""
        then = self._monotonic() - ago_s
        with self._lock:
            updates = [update for at, update, _ in self._kept if then - WINDOW_S < at <= then]
        return ChartUpdate.concatenate(updates) if updates else None

    def _keep(self, now: float) -> None:
        merged = ChartUpdate.concatenate(self._gathered)
        self._gathered = []
        size = sum(values.nbytes for values in merged.columns.values())
        self._kept.append((now, merged, size))
        self._bytes += size
        while self._bytes > self._max_bytes:
            self._bytes -= self._kept.popleft()[2]
