"""Charts gathered for a while, so that a UE that moves is passed on once with its newest place."""

from __future__ import annotations

import time

from chachart.node.data.chart import ChartUpdate

MOST_WAITING = 64
LARGEST_SHARE = 0.1
"""Passing charts on may take such a share of the time; with very many UEs it is done less often."""


class Gathering:
    """Updates in, one update of their newest rows out when it is time.

    Parameters
    ----------
    every_s
        How often; 0 gives each update at once.
    """

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._waiting: list[ChartUpdate] = []
        self._next_s = self._began_s = 0.0

    def add(self, update: ChartUpdate) -> None:
        """Keep an update."""
        self._waiting.append(update)
        if len(self._waiting) > MOST_WAITING:
            self._waiting = [ChartUpdate.concatenate(self._waiting)]

    def due(self) -> ChartUpdate | None:
        """What has been gathered, if it is time; call `done` once it is passed on."""
        return self.take() if time.monotonic() >= self._next_s else None

    def take(self) -> ChartUpdate | None:
        """What has been gathered, whether it is time or not."""
        if not self._waiting:
            return None
        update, self._waiting = ChartUpdate.concatenate(self._waiting), []
        self._began_s = time.monotonic()
        return update

    def done(self) -> None:
        """What was given is passed on: the next is due after the interval, later if this took long."""
        if self._every_s:
            took = time.monotonic() - self._began_s
            self._next_s = self._began_s + max(self._every_s, took / LARGEST_SHARE)
