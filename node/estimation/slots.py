"""Which row of the state arrays belongs to which UE: a hash table in numpy, for whole blocks at a time.

Open addressing with linear probing over a power of two of entries, at most half of them in use; an entry
holds a slot number, the slot's own row the UE's id. All operations are vectorised over UEs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.state import ROWS, Slots, SlotState, Snapshot, grown

Ids = NDArray[np.uint64]

_FREE: Final = -1
_REMOVED: Final = -2
_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)
_NEVER: Final = np.iinfo(np.int64).min


@dataclass(frozen=True, slots=True)
class Assignment:
    """What `SlotTable.assign` did.

    Attributes
    ----------
    slots
        intp (K,), the slot of each frame's UE.
    new
        Slots that were given to UEs not known before, each once: their rows must be cleared.
    evicted
        uint64, the UEs that made room.
    """

    slots: Slots
    new: Slots
    evicted: Ids


class SlotTable(SlotState):
    """Gives each UE a slot below `capacity`, keeps at most `max_ues`, knows when each was last seen.

    `capacity` grows geometrically up to `max_ues`; whoever keeps arrays by slot grows them along with it.

    Attributes
    ----------
    before_removal
        Called with slots that are about to be freed, for whoever needs what is kept there.

    Raises
    ------
    ValueError
        If `max_ues` is not positive.

    >>> table = SlotTable(max_ues=2)
    >>> table.assign(np.array([7, 9, 7], np.uint64), np.array([1, 2, 3])).slots
    array([0, 1, 0])
    >>> table.assign(np.array([5], np.uint64), np.array([4])).evicted
    array([9], dtype=uint64)
    """

    def __init__(self, max_ues: int = 100_000) -> None:
        if max_ues < 1:
            raise ValueError(f"max_ues must be at least 1, not {max_ues}")
        super().__init__()
        self.max_ues = max_ues
        self.capacity = 0
        self.before_removal: Callable[[Slots], object] = len
        self._ue = np.zeros(0, np.uint64)  # two spare rows at the end, for _FREE and _REMOVED to index
        self._last_seen = np.zeros(0, np.int64)
        self._live = np.zeros(0, np.bool_)
        self._touched = np.zeros(0, np.bool_)
        self._free = np.zeros(0, np.intp)
        self._free_count = 0
        self._oldest = np.zeros(0, np.intp)
        self._oldest_seen = np.zeros(0, np.int64)
        self._grow(min(64, max_ues))

    def __len__(self) -> int:
        return self.capacity - self._free_count

    @property
    def bytes_per_slot(self) -> int:
        """Memory that a UE takes here, with as many free entries of the hash table as there may be."""
        kept = (self._ue, self._last_seen, self._live, self._touched, self._free)
        return sum(rows.itemsize for rows in kept) + 8 * self._table.itemsize

    @property
    def slots(self) -> Slots:
        """Every slot in use, ascending."""
        return np.flatnonzero(self._live)

    @property
    def touched(self) -> Slots:
        """The slots in use that frames came for since the last `untouch`, ascending."""
        return np.flatnonzero(self._touched)

    def untouch(self) -> None:
        """Count touched slots from here on."""
        self._touched[:] = False

    def touch(self, slots: Slots) -> None:
        """Have those of `slots` that are in use count as touched."""
        self._touched[slots[self._live[slots]]] = True

    def ues(self, slots: Slots) -> Ids:
        """The UEs in `slots`."""
        return self._ue[slots]

    def lookup(self, ue: Ids) -> Slots:
        """The slot of each UE, -1 where it has none. UEs may repeat."""
        entry = self._hash(ue)
        slot = self._table[entry].astype(np.intp)
        open_ = np.flatnonzero((slot != _FREE) & ((slot == _REMOVED) | (self._ue[slot] != ue)))
        while len(open_):
            entry[open_] = (entry[open_] + 1) & self._mask
            found = self._table[entry[open_]]
            slot[open_] = found
            open_ = open_[(found != _FREE) & ((found == _REMOVED) | (self._ue[found] != ue[open_]))]
        return slot

    def assign(self, ue: Ids, time_ns: NDArray[np.int64]) -> Assignment:
        """The slot of each UE, with new slots for new UEs; the longest unseen make room beyond `max_ues`.

        Parameters
        ----------
        ue, time_ns
            uint64 (K,) and int64 (K,); UEs may repeat.

        Raises
        ------
        ValueError
            If there are more than `max_ues` different UEs in the one call.
        """
        slots = self.lookup(ue)
        evicted = np.zeros(0, np.uint64)
        new = np.zeros(0, np.intp)
        missing = slots == _FREE
        if missing.any():
            fresh, first = np.unique(ue[missing], return_index=True)
            fresh = fresh[np.argsort(first)]
            evicted = self._make_room(len(fresh), np.unique(slots[~missing]))
            new = self._insert_new(fresh)
            slots[missing] = self.lookup(ue[missing])
        np.maximum.at(self._last_seen, slots, time_ns)
        self._touched[slots] = True
        return Assignment(slots, new, evicted)

    def resize(self, capacity: int) -> None:
        """Have at least `capacity` slots."""
        if capacity > self.capacity:
            self._grow(capacity)

    def clear(self, slots: Slots) -> None:
        """Free those of `slots` that are in use."""
        self.remove(slots[self._live[slots]])

    def snapshot(self, slots: Slots | None = None) -> Snapshot:
        """`ue[]` and `last_seen[]` of `slots`, of all in use if None."""
        slots = self.slots if slots is None else slots
        return {"ue" + ROWS: self._ue[slots], "last_seen" + ROWS: self._last_seen[slots]}

    def remove(self, slots: Slots) -> None:
        """Free `slots` (each in use, none twice)."""
        if not len(slots):
            return
        self.before_removal(slots)
        self._table[self._entries(slots)] = _REMOVED
        self._live[slots] = self._touched[slots] = False
        self._last_seen[slots] = _NEVER
        self._free[self._free_count : self._free_count + len(slots)] = slots[::-1]
        self._free_count += len(slots)

    def unseen_since(self, time_ns: int) -> Slots:
        """Slots of the UEs last seen before `time_ns`."""
        return np.flatnonzero(self._live & (self._last_seen < time_ns))

    def _check(self, snapshot: Snapshot, prefix: str = "") -> None:
        for name, dtype in (("ue", np.uint64), ("last_seen", np.int64)):
            key = prefix + name + ROWS
            found = snapshot.get(key)
            if found is None or found.dtype != dtype or found.ndim != 1:
                raise ValueError(f"{key} must be in the snapshot, as {np.dtype(dtype).name} (UEs,)")
        ue = snapshot[prefix + "ue" + ROWS]
        if len(ue) > self.max_ues or len(np.unique(ue)) < len(ue):
            raise ValueError(f"{prefix}ue{ROWS} must be at most {self.max_ues} UEs, each once")

    def _take(self, snapshot: Snapshot, slots: Slots | None, prefix: str = "") -> None:
        ue, last_seen = (snapshot[prefix + name + ROWS] for name in ("ue", "last_seen"))
        slots = np.arange(len(ue)) if slots is None else slots
        self.resize(int(slots.max(initial=-1)) + 1)
        elsewhere = self.lookup(ue)
        self.clear(np.union1d(slots, elsewhere[elsewhere >= 0]))
        self._ue[slots], self._last_seen[slots], self._live[slots] = ue, last_seen, True
        self._touched[slots] = True
        self._oldest, self._oldest_seen = slots[:0], last_seen[:0]
        free = np.flatnonzero(~self._live)[::-1]
        self._free_count = len(free)
        self._free[: len(free)] = free
        self._rehash()

    def _hash(self, ue: Ids) -> NDArray[np.intp]:
        return ((ue * _GOLDEN) >> self._shift).astype(np.intp)

    def _entries(self, slots: Slots) -> NDArray[np.intp]:
        """The hash table's entries that hold `slots`."""
        entry = self._hash(self._ue[slots])
        open_ = np.flatnonzero(self._table[entry] != slots)
        while len(open_):
            entry[open_] = (entry[open_] + 1) & self._mask
            open_ = open_[self._table[entry[open_]] != slots[open_]]
        return entry

    def _insert_new(self, ue: Ids) -> Slots:
        if len(ue) > self._free_count:
            self._grow(min(max(2 * self.capacity, len(self) + len(ue)), self.max_ues))
        self._free_count -= len(ue)
        slots = self._free[self._free_count : self._free_count + len(ue)][::-1].copy()
        self._ue[slots] = ue
        self._live[slots] = True
        self._last_seen[slots] = _NEVER
        if 2 * (self._used + len(ue)) > len(self._table):
            self._rehash()
        else:
            self._enter(slots)
        return slots

    def _enter(self, slots: Slots) -> None:
        """Put `slots` into the hash table. Where several want one entry the last to write wins."""
        self._used += len(slots)
        entry = self._hash(self._ue[slots])
        while len(slots):
            wanted = self._table[entry] == _FREE
            self._table[entry[wanted]] = slots[wanted]
            lost = self._table[entry] != slots
            slots, entry = slots[lost], (entry[lost] + 1) & self._mask

    def _rehash(self) -> None:
        """Build the hash table anew for the slots in use, without the removed ones' traces."""
        bits = max(int(4 * max(len(self), 16) - 1).bit_length(), 4)
        self._table = np.full(1 << bits, _FREE, np.int32)
        self._mask = np.intp((1 << bits) - 1)
        self._shift = np.uint64(64 - bits)
        self._used = 0
        self._enter(self.slots)

    def _grow(self, capacity: int) -> None:
        old, self.capacity = self.capacity, capacity
        self._ue = grown(self._ue[:old], capacity + 2)
        self._last_seen = grown(self._last_seen, capacity)
        self._live = grown(self._live, capacity)
        self._touched = grown(self._touched, capacity)
        fresh = np.arange(capacity - 1, old - 1, -1)
        free = np.concatenate([fresh, self._free[: self._free_count]])
        self._free_count = len(free)
        self._free = grown(free, capacity)
        self._rehash()

    def _make_room(self, wanted: int, keep: Slots) -> Ids:
        """Remove as many of the longest unseen as `wanted` more UEs need, but none of `keep`."""
        excess = len(self) + wanted - self.max_ues
        if excess <= 0:
            return np.zeros(0, np.uint64)
        if wanted + len(keep) > self.max_ues:
            raise ValueError(f"max_ues is {self.max_ues}, but one block has {wanted + len(keep)} UEs")
        victims = self._next_oldest(excess, keep)
        ues = self._ue[victims].copy()
        self.remove(victims)
        return ues

    def _next_oldest(self, count: int, keep: Slots) -> Slots:
        """The `count` longest unseen slots, oldest first; of those seen at one time the lower UE first.

        A sorted queue of the oldest 1/16 serves many calls: times only grow, so an entry whose time has not
        changed since is still older than everything outside the queue.
        """
        chosen = valid = np.zeros(0, np.intp)
        for rebuild in (False, True):
            if rebuild:
                live = self.slots
                size = min(max(len(live) // 16, count + len(keep)), len(live))
                seen = self._last_seen[live]
                oldest = live[seen <= np.partition(seen, size - 1)[size - 1]]
                self._oldest = oldest[np.lexsort((self._ue[oldest], self._last_seen[oldest]))]
                self._oldest_seen = self._last_seen[self._oldest]
            unchanged = self._live[self._oldest] & (self._last_seen[self._oldest] == self._oldest_seen)
            valid = np.flatnonzero(unchanged & ~np.isin(self._oldest, keep))
            if len(valid) >= count:
                chosen = self._oldest[valid[:count]]
                break
        self._oldest, self._oldest_seen = self._oldest[valid[count:]], self._oldest_seen[valid[count:]]
        return chosen
