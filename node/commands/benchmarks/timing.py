"""Repeated timings and how they are told: the median, and the spread beside it."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Timing:
    """Seconds a call, over repeated runs."""

    median: float
    least: float
    most: float

    @classmethod
    def of(cls, seconds: list[float]) -> Timing:
        """The median and the extremes of measured values."""
        return cls(statistics.median(seconds), min(seconds), max(seconds))

    def scaled(self, factor: float) -> Timing:
        """The same in another unit."""
        return Timing(self.median * factor, self.least * factor, self.most * factor)

    def __str__(self) -> str:
        return f"{number(self.median)} ({number(self.least)}..{number(self.most)})"


def number(value: float) -> str:
    """Three digits, and no exponent for large values."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"


def time_in_turn(calls: dict[str, Callable[[], Any]], *, runs: int = 5) -> dict[str, Timing]:
    """Time several calls A B C A B C ..., so that a drift of the machine's speed meets all alike."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(runs):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            seconds[name].append(time.perf_counter() - start)
    return {name: Timing.of(values) for name, values in seconds.items()}


def plain(value: Any) -> Any:
    """`value` with every Timing as a dict, for JSON."""
    if isinstance(value, Timing):
        return asdict(value)
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value
