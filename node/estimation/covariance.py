"""Sums by UE: whole blocks of frames into weighted sums of covariances, or of their lag sums alone.

A UE's sum is A = sum over its frames of decay**age X, its weight W = sum of decay**age; the average A / W is
the plain mean (of up to `MOST_WEIGHT` frames alike) for decay = 1 and the exponentially forgetting mean,
exact from the first frame on, below that.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.native import Kernels
from chachart.node.estimation.state import Slots, SlotState

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

MOST_WEIGHT = 2.0**20
"""Frames that a plain mean weighs alike. Single precision would round away what comes after many more, so
what was there is then halved, sum and weight: the mean stays, and new frames go on counting."""

_SCRATCH_BYTES = 1 << 18


class Grouping:
    """The frames of one block by UE: `slots` holds each UE's slot once, in order of first appearance.

    Parameters
    ----------
    frame_slots
        intp (K,), the slot of each frame.

    Attributes
    ----------
    halved
        What is halved of earlier sums, see `Weights.add`: before the n-th frames are added, those of a mask
        of UEs (U,). None before anybody has looked.
    """

    def __init__(self, frame_slots: Slots) -> None:
        self.halved: dict[int, NDArray[np.bool_]] | None = None
        by_slot = np.argsort(frame_slots, kind="stable")
        ordered = frame_slots[by_slot]
        starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
        self.single = len(starts) == len(frame_slots)
        if self.single:
            self.slots: Slots = frame_slots
            self.order = self.starts = np.arange(len(frame_slots))
            self.counts = np.ones(len(frame_slots), np.intp)
            return
        counts = np.diff(starts, append=len(ordered))
        first = np.empty(len(ordered), np.intp)
        first[by_slot] = np.repeat(by_slot[starts], counts)
        self.order = np.argsort(first, kind="stable")
        appearance = np.argsort(by_slot[starts])
        self.slots = ordered[starts][appearance]
        self.counts = counts[appearance]
        self.starts = np.cumsum(self.counts) - self.counts

    def __len__(self) -> int:
        return len(self.slots)

    def part(self, ues: NDArray[np.bool_]) -> tuple[Grouping, NDArray[np.intp]]:
        """The group of some UEs (U,) alone, and which frames of the block those are."""
        frames = self.order[np.repeat(ues, self.counts)]
        slots = np.repeat(self.slots, self.counts)[np.repeat(ues, self.counts)]
        in_order = np.argsort(frames)
        return Grouping(slots[in_order]), frames[in_order]

    @cached_property
    def busiest(self) -> NDArray[np.intp]:
        """Index (U,) of the UEs, those with the most frames first."""
        return np.argsort(-self.counts, kind="stable")

    @cached_property
    def rounds(self) -> tuple[NDArray[np.intp], list[int]]:
        """The block's frames, index (K,): each UE's first one, the `busiest` first, each one's second one ...

        And how many each round has: its frames are those of so many of the busiest.
        """
        number = np.arange(len(self.order)) - np.repeat(self.starts, self.counts)
        rank = np.empty(len(self), np.intp)
        rank[self.busiest] = np.arange(len(self))
        turn = np.argsort(number * len(self) + np.repeat(rank, self.counts))
        return self.order[turn], np.bincount(number).tolist()


class Bank(SlotState):
    """Weighted sums by slot.

    Frames are added one after the other, so that sums are the same to the bit whatever blocks they came in.

    Parameters
    ----------
    shape, dtype
        Of one UE's row.
    decay
        Weight of a frame relative to the next.
    empty
        What a row holds before anything is put there.
    """

    BY_SLOT = ("rows",)

    def __init__(
        self, shape: tuple[int, ...], dtype: type[np.generic], decay: float = 1.0, empty: float = 0.0
    ) -> None:
        super().__init__()
        self.rows = np.zeros((0, *shape), dtype)
        self.decay, self.empty = decay, empty

    def clear(self, slots: Slots) -> None:
        """Start `slots` afresh."""
        self.rows[slots] = self.empty

    def add(self, group: Grouping, x: NDArray[Any]) -> NDArray[Any]:
        """Add a block's frames `x` (K, ...); returns the new sums of the block's UEs, (U, ...)."""
        halved = group.halved or {}
        if group.single:
            new = self.rows[group.slots]
            self._go_on(new, x, halved.get(0))
        else:
            frames, counts = group.rounds
            x, busiest, done = x[frames], group.busiest, 0
            by_frames = self.rows[group.slots[busiest]]
            for number, count in enumerate(counts):
                half = halved.get(number)
                part = None if half is None else half[busiest[:count]]
                self._go_on(by_frames[:count], x[done : done + count], part)
                done += count
            new = np.empty_like(by_frames)
            new[busiest] = by_frames
        self.rows[group.slots] = new
        return new

    def _go_on(self, sums: NDArray[Any], x: NDArray[Any], halved: NDArray[np.bool_] | None) -> None:
        """One frame `x` (U, ...) more in each of the sums (U, ...), in place."""
        if halved is not None:
            sums[halved] *= sums.real.dtype.type(0.5)
        if self.decay != 1.0:
            reals = sums.view(sums.real.dtype)
            reals *= reals.dtype.type(self.decay)
        sums += x


class Weights(SlotState):
    """Sum of weights W and of squared weights by slot: how many frames stand behind an average."""

    def __init__(self, decay: float) -> None:
        self._decay = decay
        self._sum, self._squares = Bank((), np.float64), Bank((), np.float64)
        super().__init__(sum=self._sum, squares=self._squares)

    def add(self, group: Grouping) -> tuple[Floats, Floats]:
        """Count a block's frames, before anything else takes them.

        Returns W and the effective number of frames W^2 / sum w^2, each (U,).
        """
        weight, squares = self._sum.rows[group.slots], self._squares.rows[group.slots]
        if group.halved is None:
            group.halved = self._full(group, weight)
        done = np.zeros(len(group), np.intp)
        for number, half in group.halved.items():
            frames = np.where(half, number - done, 0)
            weight, squares = self._after(weight, squares, frames)
            weight[half] *= 0.5
            squares[half] *= 0.25
            done += frames
        weight, squares = self._after(weight, squares, group.counts - done)
        self._sum.rows[group.slots], self._squares.rows[group.slots] = weight, squares
        return weight, weight * weight / squares

    def _after(self, weight: Floats, squares: Floats, frames: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """W and the sum of squared weights (U,) after so many more frames (U,)."""
        if self._decay == 1.0:
            return weight + frames, squares + frames
        left = np.power(self._decay, frames)
        gone, squared = 1 - left, 1 - left * left
        return (
            weight * left + gone / (1 - self._decay),
            squares * left * left + squared / (1 - self._decay * self._decay),
        )

    def _full(self, group: Grouping, weight: Floats) -> dict[int, NDArray[np.bool_]]:
        """Before which of their frames UEs reach `MOST_WEIGHT`, see `Grouping.halved`."""
        halved: dict[int, NDArray[np.bool_]] = {}
        if weight.max() + group.counts.max() <= MOST_WEIGHT:
            return halved
        weight = weight.copy()
        for number in range(int(group.counts.max())):
            full = (weight >= MOST_WEIGHT) & (group.counts > number)
            if full.any():
                halved[number] = full
                weight[full] *= 0.5
            weight = weight * self._decay + 1
        return halved

    def fade(self, slots: Slots, factor: Floats) -> None:
        """Have what came so far count `factor` (U,) times as much."""
        self._sum.rows[slots] *= factor
        self._squares.rows[slots] *= factor * factor

    def copy_from(self, other: Weights, slots: Slots) -> None:
        """Have the weights that `other` has of `slots`."""
        self._sum.rows[slots] = other._sum.rows[slots]
        self._squares.rows[slots] = other._squares.rows[slots]

    def of(self, slots: Slots) -> tuple[Floats, Floats]:
        """W and the effective number of frames of `slots`; 0 where there was none."""
        weight, squares = self._sum.rows[slots], self._squares.rows[slots]
        return weight, np.divide(weight * weight, squares, out=np.zeros_like(weight), where=squares > 0)


def covariances(x: Complex) -> Complex:
    """X Xᴴ (K, N, N) of snapshot matrices x (K, N, M), some at a time."""
    k, n, m = x.shape
    if Kernels.here and Kernels.take(x, n):
        return Kernels.here.covariances(x)
    product = np.empty((k, n, n), x.dtype)
    step = max(_SCRATCH_BYTES // (n * max(n, m) * x.itemsize), 1)
    for i in range(0, k, step):
        part = x[i : i + step]
        np.matmul(part, part.conj().swapaxes(1, 2), out=product[i : i + step])
    return product


def forward_backward(r: Complex) -> Complex:
    """Mean of Hermitian R (K, N, N) and its conjugate mirror image J R* J."""
    both: Complex = r + r[:, ::-1, ::-1].conj()
    reals = both.view(both.real.dtype)
    reals *= reals.dtype.type(0.5)
    return both
