"""The chart as it stands: the newest row of every UE that has not been forgotten."""

from __future__ import annotations

import threading
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.estimation.slots import SlotTable
from chachart.node.estimation.state import grown

_COLUMNS = [f.name for f in fields(ChartUpdate)[3:-1]]


class ChartTable:
    """Keeps the newest row of at most `max_ues` UEs; the one unseen for longest makes room. Thread-safe.

    Attributes
    ----------
    evicted, forgotten
        UEs that made room, and UEs unseen for too long.
    """

    def __init__(self, max_ues: int) -> None:
        self.evicted = 0
        self.forgotten = 0
        self._slots = SlotTable(max_ues)
        self._columns: dict[str, NDArray[Any]] = {
            name: np.zeros(0, np.int64 if name == "time_ns" else np.float64) for name in _COLUMNS
        }
        self._position = np.zeros((0, 3), np.float32)
        self._latest: tuple[str, Method] | None = None
        self._lock = threading.Lock()

    def __len__(self) -> int:
        with self._lock:
            return len(self._slots)

    def update(self, update: ChartUpdate) -> None:
        """Take rows; a UE occurs at most once. A known position stays known."""
        if len(update) > self._slots.max_ues:
            update = update.take(np.arange(len(update) - self._slots.max_ues, len(update)))
        with self._lock:
            assignment = self._slots.assign(update.ue, update.time_ns)
            self._grow()
            self.evicted += len(assignment.evicted)
            self._position[assignment.new] = np.nan
            slots = assignment.slots
            for name, column in self._columns.items():
                column[slots] = getattr(update, name)
            if update.position is not None:
                known = np.isfinite(update.position).all(axis=1)
                self._position[slots[known]] = update.position[known]
            self._latest = (update.array, update.method)

    def forget(self, before_ns: int) -> None:
        """Let go of UEs last seen before that time."""
        with self._lock:
            unseen = self._slots.unseen_since(before_ns)
            self._slots.remove(unseen)
            self.forgotten += len(unseen)

    def chart(self) -> ChartUpdate | None:
        """All rows, or None if there are none."""
        with self._lock:
            slots = self._slots.slots
            if self._latest is None or not len(slots):
                return None
            position = self._position[slots]
            array, method = self._latest
            return ChartUpdate(
                array,
                method,
                ue=self._slots.ues(slots),
                position=None if np.isnan(position).all() else position,
                **{name: column[slots] for name, column in self._columns.items()},
            )

    def _grow(self) -> None:
        capacity = self._slots.capacity
        if len(self._position) < capacity:
            self._columns = {name: grown(column, capacity) for name, column in self._columns.items()}
            self._position = grown(self._position, capacity)
