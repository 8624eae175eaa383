"""Counts by reason: what was dropped or rejected, and why."""

from __future__ import annotations

from collections.abc import Mapping


class Counters:
    """A small bag of named counts, kept per block rather than per frame.

    >>> drops = Counters()
    >>> drops.add("queue_full", 64)
    >>> drops.as_dict()
    {'queue_full': 64}
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def add(self, reason: str, n: int = 1) -> None:
        """Count `n` more for `reason`."""
        self._counts[reason] = self._counts.get(reason, 0) + n

    def merge(self, other: Mapping[str, int]) -> None:
        """Add every count of `other`."""
        for reason, n in other.items():
            self.add(reason, n)

    def __str__(self) -> str:
        """`64 queue_full, 3 late`, or `nothing`."""
        return ", ".join(f"{n} {reason}" for reason, n in self._counts.items() if n) or "nothing"

    def total(self) -> int:
        """Sum over all reasons."""
        return sum(self._counts.values())

    def as_dict(self) -> dict[str, int]:
        """A copy of the counts, by reason."""
        return dict(self._counts)
