"""State with an owner: everything kept by slot grows, is cleared, saved and restored as one tree.

A snapshot is a flat dictionary of arrays. `rho.bank.rows[]` are the rows of the slots that were asked for, in
that order; a name without brackets, as `ranging.sums`, is kept for all slots together.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

Slots = NDArray[np.intp]
Snapshot = dict[str, NDArray[Any]]

ROWS: Final = "[]"
"""How the name of an array with one row a slot ends in a snapshot."""


class SlotState:
    """Base of what keeps arrays by slot, by itself or in its children.

    A subclass names its attributes: `BY_SLOT` are arrays whose first axis is the slot, `SHARED` are numbers
    or arrays of all slots together. Numbers in `SHARED` must be such that those of two estimators can be
    added up, which is what happens when their UEs come together in one.

    Parameters
    ----------
    children
        By the name that they have in snapshots.
    """

    BY_SLOT: ClassVar[tuple[str, ...]] = ()
    SHARED: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **children: SlotState) -> None:
        self.children = children

    @property
    def bytes_per_slot(self) -> int:
        """Memory that the rows of one slot take."""
        own = (getattr(self, name) for name in self.BY_SLOT)
        bytes_of_own = sum(int(rows.itemsize) * math.prod(rows.shape[1:]) for rows in own)
        return int(bytes_of_own) + sum(child.bytes_per_slot for child in self.children.values())

    def resize(self, capacity: int) -> None:
        """Have rows for at least `capacity` slots; new ones are zero."""
        for name in self.BY_SLOT:
            rows = getattr(self, name)
            if capacity > len(rows):
                setattr(self, name, grown(rows, capacity))
        for child in self.children.values():
            child.resize(capacity)

    def clear(self, slots: Slots) -> None:
        """Start `slots` afresh."""
        for name in self.BY_SLOT:
            getattr(self, name)[slots] = 0
        for child in self.children.values():
            child.clear(slots)

    def snapshot(self, slots: Slots | None = None) -> Snapshot:
        """Copies of the rows of `slots`, all if None, and of what is shared."""
        found: Snapshot = {}
        for name in self.BY_SLOT:
            rows = getattr(self, name)
            found[_public(name) + ROWS] = rows.copy() if slots is None else rows[slots]
        for name in self.SHARED:
            found[_public(name)] = np.array(getattr(self, name))
        for name, child in self.children.items():
            found |= {f"{name}.{key}": value for key, value in child.snapshot(slots).items()}
        return found

    def restore(self, snapshot: Snapshot, slots: Slots | None = None) -> None:
        """Take the rows of a snapshot into `slots`, the first ones if None, and what is shared.

        Other slots keep what they have; names that nobody here has are ignored.

        Raises
        ------
        ValueError
            If something is missing or does not fit; nothing has changed then.
        """
        self.check(snapshot)
        self._take(snapshot, slots)

    def check(self, snapshot: Snapshot) -> None:
        """Does a snapshot have everything that is kept here?

        Raises
        ------
        ValueError
            If something is missing or does not fit.
        """
        counts = {len(value) for name, value in snapshot.items() if name.endswith(ROWS)}
        if len(counts) > 1:
            raise ValueError(f"the snapshot's arrays have {sorted(counts)} rows, instead of all alike")
        self._check(snapshot)

    def _check(self, snapshot: Snapshot, prefix: str = "") -> None:
        for name in (*self.BY_SLOT, *self.SHARED):
            by_slot = name in self.BY_SLOT
            mine = np.asarray(getattr(self, name))
            key = prefix + _public(name) + (ROWS if by_slot else "")
            if key not in snapshot:
                raise ValueError(f"{key} is not in the snapshot")
            expected = (mine.shape[1:] if by_slot else mine.shape, mine.dtype)
            there = snapshot[key]
            found = (there.shape[1:] if by_slot else there.shape, there.dtype)
            if found != expected:
                raise ValueError(f"{key} must be {expected[1]} {expected[0]}, not {found[1]} {found[0]}")
        for name, child in self.children.items():
            child._check(snapshot, f"{prefix}{name}.")

    def _take(self, snapshot: Snapshot, slots: Slots | None, prefix: str = "") -> None:
        for name in self.BY_SLOT:
            rows = snapshot[prefix + _public(name) + ROWS]
            if slots is None:
                slots = np.arange(len(rows))
            if len(slots) and slots.max() >= len(getattr(self, name)):
                setattr(self, name, grown(getattr(self, name), int(slots.max()) + 1))
            getattr(self, name)[slots] = rows
        for name in self.SHARED:
            value = snapshot[prefix + _public(name)].copy()
            setattr(self, name, value if value.ndim else value.item())
        for name, child in self.children.items():
            child._take(snapshot, slots, f"{prefix}{name}.")


def grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    """`array` with zero rows appended up to `rows`; untouched new memory costs nothing yet."""
    larger = np.zeros((rows, *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


def _public(name: str) -> str:
    return name.lstrip("_")
