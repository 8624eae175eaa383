"""What an estimator remembers of its UEs, and how that is copied while it goes on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.csi import CsiBlock
from chachart.node.estimation.covariance import Bank, Grouping
from chachart.node.estimation.locator import Locator
from chachart.node.estimation.slots import Assignment, Ids, SlotTable
from chachart.node.estimation.state import ROWS, Slots, SlotState, Snapshot

LATEST = ("theta", "rho", "theta_std", "rho_std")
"""What is remembered of a UE's last row, to go with its spectrum."""

POSITION_AGE_NS = 10 * 10**9
"""For so long a known position is told of a UE whose newer frames tell none; for training, never."""


class Memory(SlotState):
    """Who has which slot, their positions and last rows, and the locator's state.

    Attributes
    ----------
    table, locator
        See there.
    position, position_ns, latest
        By slot: the last known position, when it was known, and the last row by column.
    """

    def __init__(self, max_ues: int, locator: Locator) -> None:
        self.table = SlotTable(max_ues)
        self.position = Bank((3,), np.float32, empty=np.nan)
        self.position_ns = Bank((), np.int64)
        self.latest = {name: Bank((), np.float64, empty=np.nan) for name in LATEST}
        self.locator = locator
        self._copy: Copy | None = None
        super().__init__(
            table=self.table,
            position=self.position,
            position_ns=self.position_ns,
            latest=SlotState(**self.latest),
            locator=locator,
        )
        self.resize(self.table.capacity)

    def assign(self, ue: Ids, time_ns: NDArray[np.int64]) -> Assignment:
        """Slots for a block's UEs, with clean rows for new ones."""
        if self._copy is not None:
            known = self.table.lookup(ue)
            self._copy.put_aside(np.unique(known[known >= 0]))
        assigned = self.table.assign(ue, time_ns)
        if len(assigned.new):
            self.resize(self.table.capacity)
            for name in ("position", "position_ns", "latest", "locator"):
                self.children[name].clear(assigned.new)
        return assigned

    def positions(
        self, block: CsiBlock, group: Grouping, time_ns: NDArray[np.int64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions (U, 3) that the block tells of its UEs, and the last known ones that are not too old."""
        slots = group.slots
        rows, told_ns = self.position.rows, self.position_ns.rows
        told = np.full((len(group), 3), np.nan, np.float32)
        if block.position is not None:
            known = ~np.isnan(block.position.sum(axis=1))
            index = np.where(known[group.order], np.arange(len(known)), -1)
            latest = np.maximum.reduceat(index, group.starts)
            has = latest >= 0
            frames = group.order[latest[has]]
            told[has] = rows[slots[has]] = block.position[frames]
            told_ns[slots[has]] = block.time_ns[frames]
        lasting = rows[slots]
        lasting[time_ns - told_ns[slots] > POSITION_AGE_NS] = np.nan
        return told, lasting

    def replace_locator(self, locator: Locator) -> None:
        """Go on with another locator, which knows nothing yet: every UE counts as touched."""
        self.give_up_copy()
        self.locator = self.children["locator"] = locator
        self.resize(self.table.capacity)
        self.table.touch(self.table.slots)

    def copy(self, *, touched: bool, beside: Snapshot) -> Copy:
        """A copy of this moment, of all UEs or those touched since the last copy; see `Copy`."""
        self.give_up_copy()
        slots = self.table.touched if touched else self.table.slots
        self.table.untouch()
        self._copy = Copy(self, slots, beside)
        self.table.before_removal = self._copy.put_aside
        return self._copy

    def give_up_copy(self) -> None:
        """No more pieces of a copy under way: what it lacks counts as touched."""
        if self._copy is not None:
            self.table.touch(self._copy.left)
            self._copy.given_up = True
            self._copy = None


class Copy:
    """A copy of one moment, taken in pieces while the estimator goes on.

    Rows that are about to change before their turn are put aside first, so that all pieces together are what
    was there at the moment that this was made. Each piece is a snapshot for `snapshots.joined`.

    Parameters
    ----------
    memory, slots
        Of what.
    beside
        What goes into every piece beside the rows.

    Attributes
    ----------
    ues
        How many UEs the copy is of.
    given_up
        The method has changed, or another copy was begun, before this one was complete.
    """

    def __init__(self, memory: Memory, slots: Slots, beside: Snapshot) -> None:
        shared = {k: v for k, v in memory.snapshot(slots[:0]).items() if not k.endswith(ROWS)}
        self._memory, self._beside = memory, shared | beside
        self._open = np.zeros(memory.table.capacity, np.bool_)
        self._open[slots] = True
        self._order, self._next = slots, 0
        self._aside: list[Snapshot] = []
        self._empty = not len(slots)
        self.given_up = False
        self.ues = len(slots)

    @property
    def left(self) -> Slots:
        """Slots whose rows have not been copied yet."""
        return np.flatnonzero(self._open)

    def piece(self, rows: int) -> Snapshot | None:
        """The next piece, of at most so many UEs beside those put aside; None after the last.

        There is at least one, if of no UE; but none once the copy is given up.
        """
        if self.given_up:
            return None
        if not self._aside:
            self._take(self._following(rows))
        return self._aside.pop(0) if self._aside else None

    def put_aside(self, slots: Slots) -> None:
        """The rows of these slots are about to change."""
        slots = slots[slots < len(self._open)]
        slots = slots[self._open[slots]]
        if len(slots):
            self._take(slots)

    def _following(self, rows: int) -> Slots:
        while self._next < len(self._order):
            wanted = self._order[self._next : self._next + rows]
            self._next += rows
            if len(wanted := wanted[self._open[wanted]]):
                return wanted
        return self._order[:0]

    def _take(self, slots: Slots) -> None:
        if not len(slots) and not self._empty:
            return
        self._empty = False
        self._open[slots] = False
        rows = {k: v for k, v in self._memory.snapshot(slots).items() if k.endswith(ROWS)}
        self._aside.append(rows | self._beside)
