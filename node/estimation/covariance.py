"""Sums by UE: whole blocks of frames into weighted sums of covariances, or of their lag sums alone.

A UE's sum is A = sum over its frames of decay**age X, its weight W = sum of decay**age; the average A / W is
the plain mean (of up to `MOST_WEIGHT` frames alike) for decay = 1 and the exponentially forgetting mean,
exact from the first frame on, below that.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.state import Slots, SlotState

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

MATMUL_LIMIT = 64
"""Up to this size, lag sums come from the covariance itself; beyond, FFTs need fewer operations."""

MOST_WEIGHT = 2.0**20
"""Frames that a plain mean weighs alike. Single precision would round away what comes after many more, so
what was there is then halved, sum and weight: the mean stays, and new frames go on counting."""

_SCRATCH_BYTES = 1 << 20
_TRANSFORM_BYTES = 4 << 20


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


class LagSums:
    """Sums of N x N Hermitian matrices over pairs of elements of equal lag: the polynomial of aᴴ(u) Q a(u).

    With a_n(u) = exp(j p_n u), aᴴ Q a = Re sum_k c_k exp(j k u) where c_k sums Q's entries of p_m - p_n = k:
    c_0 once, the rest twice. For an even row these are its diagonals: matrices are written into the left half
    of zeros twice as wide; read with rows one element longer, their diagonals lie in columns. Gaps are filled
    with zeros before. Entries of sparse lattices are picked in the order of their lags.
    """

    def __init__(self, lattice: Lattice) -> None:
        self.lattice = lattice
        self._scratch: dict[np.dtype[Any], tuple[Complex, NDArray[Any]]] = {}
        if lattice.sparse:
            first, second = np.triu_indices(lattice.size)
            lag = lattice.index[second] - lattice.index[first]
            order = np.argsort(lag, kind="stable")
            self._entries = (first * lattice.size + second)[order]
            self._starts = np.searchsorted(lag[order], lattice.lags)

    def of(self, q: Complex) -> Complex:
        """Lag polynomials (K, L) of Hermitian matrices q (K, N, N)."""
        if self.lattice.sparse:
            c: Complex = np.add.reduceat(q.reshape(len(q), -1)[:, self._entries], self._starts, axis=1)
            c[:, 1:] *= 2
            return c
        q = self.lattice.spread_out(self.lattice.spread_out(q, 1), 2)
        return self._sums(len(q), q.dtype, lambda part, out: np.copyto(out, q[part]))

    def of_products(self, x: Complex, conjugate: Complex) -> Complex:
        """Lag polynomials (K, L) of X Xᴴ for factors x (K, N, M) and their conjugates."""
        if self.lattice.sparse:
            return self.of(np.matmul(x, conjugate.swapaxes(1, 2)))
        n = self.lattice.span
        x = self.lattice.spread_out(x, 1)
        if n > MATMUL_LIMIT:
            points = fft.next_fast_len(2 * n)
            step = max(_TRANSFORM_BYTES // (points * x.shape[2] * x.itemsize), 1)
            return np.concatenate(
                [self._of_spectrum(x[i : i + step], points) for i in range(0, len(x), step)]
            )
        across = self.lattice.spread_out(conjugate, 1).swapaxes(1, 2)
        return self._sums(len(x), x.dtype, lambda part, out: np.matmul(x[part], across[part], out=out))

    def _of_spectrum(self, x: Complex, points: int) -> Complex:
        transform = np.ascontiguousarray(fft.fft(x, points, axis=1))
        reals = transform.view(transform.real.dtype)
        power = np.einsum("kfm,kfm->kf", reals, reals)
        c: Complex = fft.rfft(power, axis=1, norm="forward")[:, : self.lattice.span]
        c[:, 1:] *= 2
        return c

    def _sums(self, count: int, dtype: np.dtype[Any], fill: Callable[[slice, Complex], object]) -> Complex:
        """Lag polynomials of `count` matrices, which `fill` writes, some at a time."""
        c = np.empty((count, self.lattice.span), dtype)
        room, diagonals = self._memory(count, dtype)
        for i in range(0, count, len(room)):
            part = slice(i, min(i + len(room), count))
            fill(part, room[: part.stop - i])
            c[part] = np.einsum("kij->kj", diagonals[: part.stop - i]).view(dtype)
        c[:, 1:] *= 2
        return c

    def _memory(self, count: int, dtype: np.dtype[Any]) -> tuple[Complex, NDArray[Any]]:
        """Room for `count` matrices, or as many as stay in cache, and its view with diagonals as columns."""
        n = self.lattice.span
        count = min(count, max(_SCRATCH_BYTES // (2 * n * n * dtype.itemsize), 1))
        if dtype not in self._scratch or len(self._scratch[dtype][0]) < count:
            memory = np.zeros((count, n, 2 * n), dtype)
            reals = memory.view(memory.real.dtype)
            step = reals.strides[-1]
            strides = (reals.strides[0], (4 * n + 2) * step, step)
            diagonals = np.lib.stride_tricks.as_strided(reals, (count, n, 2 * n), strides)
            self._scratch[dtype] = memory[:, :, :n], diagonals
        return self._scratch[dtype]


def forward_backward(r: Complex) -> Complex:
    """Mean of Hermitian R (K, N, N) and its conjugate mirror image J R* J."""
    both: Complex = r + r[:, ::-1, ::-1].conj()
    reals = both.view(both.real.dtype)
    reals *= reals.dtype.type(0.5)
    return both
