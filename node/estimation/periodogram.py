"""Angle-delay power spectra of many UEs: what the joint method keeps by slot, and reads.

The spectrum of a frame H is its two-dimensional periodogram without a window,

    P(u, v) = |sum_mn H_mn exp(-j u m + j v n)|^2,

sampled on a grid of (at least) twice the array's size. Being a trigonometric polynomial of degrees below N_R
and N_S, it is thereby known exactly between the grid's points too (`Periodogram.derivatives`). Where elements
or tones leave gaps, zeros take their places, and N_R and N_S are what they span.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from chachart.node.estimation.covariance import Bank, Grouping, Weights
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.products import row_products
from chachart.node.estimation.state import Slots, SlotState

Csi = NDArray[np.complex64]
Power = NDArray[np.float32]
Floats = NDArray[np.float64]

_CHUNK_BYTES = 1 << 21
"""Spectra are made and read so many bytes at a time, to stay in the cache ..."""
TRANSFORMS = 8
"""... and transformed in so many parts of that, because transforms take as much again for each step."""


class Periodogram:
    """P of frames of one size.

    Parameters
    ----------
    antennas, tones
        Where the elements are, and the tones.

    Attributes
    ----------
    shape
        (N_R, N_S) of the frames.
    span
        Places on both axes.
    grid
        (A, D): points on the circle of u and on that of v, 2 pi i / A and 2 pi j / D.
    chunk
        How many spectra are best worked on at a time.
    """

    def __init__(self, antennas: Lattice, tones: Lattice) -> None:
        self._antennas, self._tones = antennas, tones
        self.shape = antennas.size, tones.size
        self.span = antennas.span, tones.span
        self.grid = fft.next_fast_len(2 * antennas.span), fft.next_fast_len(2 * tones.span)
        self.chunk = max(_CHUNK_BYTES // (4 * self.grid[0] * self.grid[1]), 1)
        self._interpolators = [Interpolator(n, g) for n, g in zip(self.span, self.grid, strict=True)]

    def of(self, csi: Csi) -> Power:
        """P (K, A, D) of frames (K, N_R, N_S)."""
        power = np.empty((len(csi), *self.grid), np.float32)
        few = max(self.chunk // TRANSFORMS, 1)
        for i in range(0, len(csi), few):
            part = power[i : i + few]
            placed = self._tones.spread_out(csi[i : i + few], 2)
            delays = self._antennas.spread_out(fft.ifft(placed, self.grid[1], axis=2, norm="forward"), 1)
            np.absolute(fft.fft(delays, self.grid[0], axis=1, overwrite_x=True), out=part)
            part *= part
        return power

    def derivatives(self, power: Power, u: NDArray[Any], v: NDArray[Any]) -> Floats:
        """(K, 3, 3): [i, j] is the i-th derivative by u and j-th by v of spectra (K, A, D) at u, v (K,)."""
        left, right = self._interpolators[0](u), self._interpolators[1](v)
        values: NDArray[np.float32] = np.matmul(left, np.matmul(power, right.swapaxes(1, 2)))
        return values.astype(np.float64)

    def sampled(self, power: Power, u: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
        """One spectrum (A, D) at all pairs of u (I,) and v (J,): (I, J)."""
        values: NDArray[Any] = self._interpolators[0](u)[:, 0] @ power @ self._interpolators[1](v)[:, 0].T
        return values


class Interpolator:
    """From a periodic grid's values of a real trigonometric polynomial of degree below n to anywhere.

    f(x) = sum_p f(p) sum_k w_k cos k (x - p) over the grid's points p, w_0 = 1 / grid and w_k = 2 / grid: the
    Dirichlet kernel, and by x its derivatives.
    """

    def __init__(self, n: int, grid: int) -> None:
        k = np.arange(n)[:, None]
        angle = k * (2 * np.pi / grid) * np.arange(grid)
        weight = np.where(k == 0, 1, 2) / grid
        cos, sin = weight * np.cos(angle), weight * np.sin(angle)
        # rows for cos kx, then for sin kx; columns for the value, the slope and the curvature
        table = np.block([[cos, k * sin, -k * k * cos], [sin, -k * cos, -k * k * sin]])
        self._table = table.astype(np.float32)
        self._order = np.arange(n, dtype=np.float32)

    def __call__(self, x: NDArray[Any]) -> Power:
        """(K, 3, grid): what to weigh the grid's values with for value, slope and curvature at x (K,)."""
        angle = np.asarray(x, np.float32)[:, None] * self._order
        rows = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
        weights: Power = row_products(rows, self._table).reshape(len(rows), 3, -1)
        return weights


class SpectrumState(SlotState):
    """Frames in, averaged spectra out, by slot."""

    @abstractmethod
    def take(self, group: Grouping, csi: Csi) -> None:
        """Take a block's frames (K, N_R, N_S)."""

    @abstractmethod
    def spectra(self, slots: Slots) -> tuple[Power, Floats, Floats]:
        """P (U, A, D), and (U,) how many looks it averages and how many frames each look adds up in phase.

        A look is a spectrum of independent noise; the noise's level in P is that of one frame.
        """


class CoherentSums(SpectrumState):
    """Sum of each UE's frames themselves, 8 bytes an element: for UEs and oscillators that keep their phase.

    The spectrum is that of the sum, P(sum_i w_i H_i) / sum_i w_i^2: one look, in which the signal is
    1 / sum w^2 (with weights that add up to 1) frames strong.

    Parameters
    ----------
    periodogram
        Of the array.
    decay
        Weight of a frame relative to the next.
    """

    def __init__(self, periodogram: Periodogram, decay: float) -> None:
        self._periodogram = periodogram
        self.bank = Bank(periodogram.shape, np.complex64, decay)
        self.weights = Weights(decay)
        super().__init__(bank=self.bank, weights=self.weights)

    def take(self, group: Grouping, csi: Csi) -> None:
        """Take a block's frames."""
        self.weights.add(group)
        self.bank.add(group, csi)

    def fade(self, slots: Slots, factor: Floats) -> None:
        """Have what came so far count `factor` (U,) times as much."""
        self.weights.fade(slots, factor)
        self.bank.rows[slots] *= factor.astype(np.float32)[:, None, None]

    def spectra(self, slots: Slots) -> tuple[Power, Floats, Floats]:
        """See `SpectrumState`."""
        weight, frames = self.weights.of(slots)
        sums = self.bank.rows[slots]
        sums *= (np.sqrt(frames) / weight).astype(np.float32)[:, None, None]
        return self._periodogram.of(sums), np.ones(len(slots)), frames


class PowerSums(SpectrumState):
    """Sum of each UE's spectra, 16 bytes an element: whatever the phase of its frames, or its echoes', does.

    Parameters
    ----------
    periodogram
        Of the array.
    decay
        Weight of a frame relative to the next.
    """

    def __init__(self, periodogram: Periodogram, decay: float) -> None:
        self._periodogram = periodogram
        self._bank = Bank(periodogram.grid, np.float32, decay)
        self._weights = Weights(decay)
        super().__init__(bank=self._bank, weights=self._weights)

    def take(self, group: Grouping, csi: Csi) -> None:
        """Take a block's frames."""
        power = np.empty((len(csi), *self._periodogram.grid), np.float32)
        for i in range(0, len(csi), self._periodogram.chunk):
            part = slice(i, i + self._periodogram.chunk)
            power[part] = self._periodogram.of(csi[part])
        self._weights.add(group)
        self._bank.add(group, power)

    def take_over(self, slots: Slots, other: CoherentSums) -> None:
        """Begin with what `other` has of `slots`: its spectra count as one look each."""
        self.clear(slots)
        for i in range(0, len(slots), self._periodogram.chunk):
            part = slots[i : i + self._periodogram.chunk]
            self._bank.rows[part] = other.spectra(part)[0]
        self._weights.add(Grouping(slots))

    def spectra(self, slots: Slots) -> tuple[Power, Floats, Floats]:
        """See `SpectrumState`."""
        weight, looks = self._weights.of(slots)
        power = self._bank.rows[slots]
        power *= (1 / weight).astype(np.float32)[:, None, None]
        return power, looks, np.ones(len(slots))


def energy(x: Csi) -> Floats:
    """Sum of |x|^2 along the second of two axes."""
    reals = x.view(np.float32)
    total: NDArray[np.float32] = np.einsum("ki,ki->k", reals, reals)
    return total.astype(np.float64)
