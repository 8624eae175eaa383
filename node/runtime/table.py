"""The chart as it stands: the newest row of every UE that has not been forgotten."""

from __future__ import annotations

import threading
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS
from chachart.node.estimation.slots import SlotTable
from chachart.node.estimation.state import grown


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
        self._columns: dict[str, NDArray[Any]] = {}
        self._latest: tuple[str, Method, Collection[str]] | None = None
        self._lock = threading.Lock()

    def __len__(self) -> int:
        with self._lock:
            return len(self._slots)

    def update(self, update: ChartUpdate) -> None:
        """Take rows; a UE occurs at most once."""
        if len(update) > self._slots.max_ues:
            update = update.take(np.arange(len(update) - self._slots.max_ues, len(update)))
        with self._lock:
            assignment = self._slots.assign(update.ue, update.time_ns)
            self.evicted += len(assignment.evicted)
            for name in [name for name in update.columns if name not in self._columns]:
                self._columns[name] = COLUMNS[name].missing(self._slots.capacity)
            for name, kept in self._columns.items():
                if len(kept) < self._slots.capacity:
                    self._columns[name] = kept = grown(kept, self._slots.capacity)
                kept[assignment.slots] = update.columns.get(name, COLUMNS[name].fill)
            self._latest = (update.array, update.method, update.columns.keys())

    def clear(self) -> None:
        """Begin anew with no UE."""
        with self._lock:
            self._slots.remove(self._slots.slots)

    def forget(self, before_ns: int) -> None:
        """Let go of UEs last seen before that time."""
        with self._lock:
            unseen = self._slots.unseen_since(before_ns)
            self._slots.remove(unseen)
            self.forgotten += len(unseen)

    def remove(self, ue: NDArray[np.uint64]) -> None:
        """Let go of these UEs, those that are here."""
        with self._lock:
            slots = self._slots.lookup(ue)
            self._slots.remove(slots[slots >= 0])

    def chart(self) -> ChartUpdate | None:
        """All rows, or None if there are none."""
        with self._lock:
            slots = self._slots.slots
            if self._latest is None or not len(slots):
                return None
            columns = {name: kept[slots] for name, kept in self._columns.items() if name != "ue"}
            array, method, given = self._latest
            return ChartUpdate(
                array,
                method,
                ue=self._slots.ues(slots),
                **{
                    name: values
                    for name, values in columns.items()
                    if name in given or COLUMNS[name].known(values).any()
                },
            )
