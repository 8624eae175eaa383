"""Steering vectors and the search over them: a grid as one real matrix product, then Newton steps.

On a lattice of places p_n, a_n(u) = exp(j p_n u), so that aᴴQa is the trigonometric polynomial Re sum_k c_k
exp(j k u) of Q's lag sums and has exact derivatives. The angle manifold's snapshots are the subcarriers, the
delay manifold's the antennas.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.lattice import SPARSE, Lattice, Whole
from chachart.node.estimation.native import Kernels
from chachart.node.estimation.products import row_products

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

GRID_PER_ELEMENT = 4
"""Grid points per resolution cell 2 pi / N where no step is set: the peak lies within 1/8 of a cell of one of
them, where the main lobe has lost 5 %, well inside the region that Newton steps converge from."""

MOST_FINER = 16
"""How many times finer the grid may get where side lobes are nearly as high as the main one."""

SURE = 6.0
"""Standard deviations beyond which noise is not expected to reach."""
CONVERGED = 1e-4
"""In resolution cells: after a step as small, Newton's error is of the order of its square."""


@dataclass(frozen=True, slots=True)
class UniformManifold(ABC):
    """a_n(u) = exp(j p_n u) for u in [low, high].

    Attributes
    ----------
    lattice
        p_n, n = 0 ... N - 1.
    low, high
        Range of u that is searched.
    phase
        u of one unit: of metres, or of the cosine of theta.
    """

    lattice: Lattice
    low: float
    high: float
    phase: float

    @property
    def size(self) -> int:
        """N, elements of the steering vector."""
        return self.lattice.size

    def steering(self, u: Any) -> NDArray[np.complex128]:
        """Steering vectors (..., N) at u (...)."""
        u = np.asarray(u, np.float64)
        return phasors(u.reshape(-1), self.lattice.index).T.reshape(*u.shape, self.size)

    @abstractmethod
    def coordinate(self, u: Floats) -> Floats:
        """What u stands for."""

    @abstractmethod
    def u(self, coordinate: Any) -> Floats:
        """The u that a coordinate stands for."""

    @abstractmethod
    def coordinate_std(self, u: Floats, u_std: Floats) -> Floats:
        """Standard deviation of the coordinate, given that of u."""

    def multiples(self, step: float) -> Floats:
        """The multiples of `step` that the coordinate's range holds."""
        low, high = self._ends()
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        return step * np.arange(first, last + 1, dtype=np.float64)

    def points(self, count: int) -> Floats:
        """`count` equidistant coordinates, from one end of the range to the other."""
        return np.linspace(*self._ends(), count)

    def _ends(self) -> tuple[float, float]:
        ends = self.coordinate(np.array([self.low, self.high]))
        return float(ends.min()), float(ends.max())


@dataclass(frozen=True, slots=True)
class AngleManifold(UniformManifold):
    """u = phase cos(theta), phase being that of one step of the lattice.

    Beyond half a wavelength of element spacing only the unambiguous |u| <= pi is searched.
    """

    @classmethod
    def of(cls, array: ArrayGeometry) -> AngleManifold:
        """The array's elements that count, at the middle of its band."""
        lattice, step = Lattice.of_antennas(array)
        phase = step * array.theta_phase * array.middle_hz / array.carrier_hz
        edge = min(phase, math.pi)
        return cls(lattice, low=-edge, high=edge, phase=phase)

    def coordinate(self, u: Floats) -> Floats:
        """theta in rad."""
        return np.arccos(np.clip(u / self.phase, -1, 1))

    def u(self, coordinate: Any) -> Floats:
        """u at theta."""
        return self.phase * np.cos(np.asarray(coordinate, np.float64))

    def coordinate_std(self, u: Floats, u_std: Floats) -> Floats:
        """|d theta / d u| = 1 / (phase sin theta); near the array's axis the curve's own bend limits it.

        Where u turned by 2 pi is a direction, too, or misses one by no more than noise may make up for, the
        estimate may be either: the error is then the distance between both, as often as that happens.
        """
        spread = u_std / self.phase
        sine = np.sqrt(np.maximum(1 - (u / self.phase) ** 2, 0))
        std: Floats = spread / np.maximum(sine, np.sqrt(spread))
        missing = 2 * math.pi - np.abs(u) - self.phase
        either = np.flatnonzero(missing < SURE * u_std)
        if len(either):
            other = -np.sign(u[either]) * np.minimum(2 * math.pi - np.abs(u[either]), self.phase)
            apart = self.coordinate(u[either]) - self.coordinate(other)
            often = np.minimum(ndtr(-missing[either] / u_std[either]), 0.5)
            std[either] = np.sqrt(std[either] ** 2 + often * apart**2)
        return std


@dataclass(frozen=True, slots=True)
class DelayManifold(UniformManifold):
    """u = phase rho, phase = -2 pi spacing / c times the step of the lattice of tones."""

    @classmethod
    def of(cls, array: ArrayGeometry, rho_max_m: float) -> DelayManifold:
        """The array's tones that count, from range 0 to `rho_max_m` or to what is unambiguous."""
        lattice, step = Lattice.of_tones(array)
        phase = step * array.rho_phase
        far = min(rho_max_m, array.unambiguous_rho_m)
        return cls(lattice, low=phase * far, high=0.0, phase=phase)

    def coordinate(self, u: Floats) -> Floats:
        """rho in m."""
        return np.abs(u / self.phase)

    def u(self, coordinate: Any) -> Floats:
        """u at rho."""
        return self.phase * np.asarray(coordinate, np.float64)

    def coordinate_std(self, u: Floats, u_std: Floats) -> Floats:
        """u is proportional to rho."""
        return u_std / abs(self.phase)


class Search:
    """Finds the extremum of lag polynomials over a manifold's range.

    Parameters
    ----------
    manifold
        Where to look.
    step
        Grid step of the manifold's coordinate; None for `GRID_PER_ELEMENT` steps of u per resolution cell.
    newton_steps
        Newton steps after the grid.
    """

    def __init__(self, manifold: UniformManifold, step: float | None, newton_steps: int) -> None:
        self.manifold = manifold
        self.newton_steps = newton_steps
        low, high = manifold.low, manifold.high
        self._full_circle = high - low > 2 * math.pi * (1 - 1e-9)
        if step is None:
            cell = 2 * math.pi / manifold.lattice.span / GRID_PER_ELEMENT
            cell = max(min(cell, _safe_step(manifold.lattice)), cell / MOST_FINER)
            self.grid = np.linspace(low, high, max(math.ceil((high - low) / cell), 4) + 1)
        else:
            self.grid = np.sort(manifold.u(manifold.multiples(step)))
        if self._full_circle and self.grid[-1] - self.grid[0] > 2 * math.pi * (1 - 1e-9):
            self.grid = self.grid[:-1]
        self.converged = CONVERGED * 2 * math.pi / manifold.lattice.span
        self._before, self._after = (
            np.roll(np.arange(len(self.grid)), 1),
            np.roll(np.arange(len(self.grid)), -1),
        )
        self._low, self._high = self.grid[self._before], self.grid[self._after]
        if self._full_circle:
            self._low[0] -= 2 * math.pi
            self._high[-1] += 2 * math.pi
        else:
            self._before[0], self._after[-1] = 0, len(self.grid) - 1
            self._low[0], self._high[-1] = low, high
        self._tables: dict[np.dtype[Any], NDArray[Any]] = {}

    def spectrum(self, c: Complex) -> NDArray[Any]:
        """aᴴQa (K, G) on the grid, of lag polynomials (K, L): one real matrix product."""
        real = c.real.dtype
        if real not in self._tables:
            self._tables[real] = polynomial_table(self.grid, self.manifold.lattice.lags).astype(real)
        return row_products(c.view(real), self._tables[real])

    def extremum(self, c: Complex, *, maximum: bool) -> tuple[Floats, Floats]:
        """u (K,) where the polynomials (K, L) are largest or least, and their values there (K,).

        From the grid's best point to the vertex of the parabola through it and its neighbours, then by
        Newton steps. These stay between the neighbours; one that would leave, or that a curvature of the
        wrong sign would turn the wrong way, is replaced by bisection. They end early once all are so small
        that the next would not matter.
        """
        values = self.spectrum(c)
        lattice = self.manifold.lattice
        if self.newton_steps and lattice.dense and Kernels.here and Kernels.take(c, lattice.span):
            u, value = Kernels.here.extremum(
                values,
                c,
                (self.grid, self._before, self._after, self._low, self._high),
                maximum=maximum,
                steps=self.newton_steps,
                converged=self.converged,
            )
            return self._round(u), value
        best = values.argmax(axis=1) if maximum else values.argmin(axis=1)
        row = np.arange(0, values.size, values.shape[1])
        u, value = self.grid[best], values.take(row + best).astype(np.float64)
        if not self.newton_steps:
            return u, value
        before, after, low, high = self._before[best], self._after[best], self._low[best], self._high[best]
        fall_left, fall_right = values.take(row + before) - value, values.take(row + after) - value
        inner = (before != best) & (after != best)
        u = u + np.where(inner, _vertex(u - low, high - u, fall_left, fall_right), 0.0)
        exact = np.array(c.T, np.complex128, order="C")
        if maximum:
            np.negative(exact, out=exact)
        with np.errstate(divide="ignore", invalid="ignore"):
            u, value = _descend(exact, lattice, u, low, high, self.newton_steps, self.converged)
        return self._round(u), -value if maximum else value

    def _round(self, u: Floats) -> Floats:
        """u in the range, where that is the full circle."""
        if self._full_circle:
            u = self.manifold.low + np.mod(u - self.manifold.low, 2 * math.pi)
        return u


def _descend(
    c: NDArray[np.complex128],
    lattice: Lattice,
    u: Floats,
    low: Floats,
    high: Floats,
    steps: int,
    converged: float,
) -> tuple[Floats, Floats]:
    """Newton steps from u (K,) to a minimum of c (L, K) within [low, high], and the value there.

    Each stays where its step was small enough, whatever the others still do.
    """
    done = np.zeros(len(u), np.bool_)
    for _ in range(steps):
        value, slope, curvature = derivatives(c, u, lattice)
        target = u - slope / curvature
        sound = (curvature > 0) & (target >= low) & (target <= high)
        if not sound.all():
            uphill = slope > 0
            low, high = np.where(uphill, low, u), np.where(uphill, u, high)
            target = np.where(sound & (target >= low) & (target <= high), target, (low + high) / 2)
        step = np.where(done, 0, target - u)
        u = u + step
        done |= np.abs(step) < converged
        if done.all():
            break
    return u, value + step * (slope + 0.5 * step * curvature)


def _safe_step(lattice: Lattice) -> float:
    """Grid step at which the main lobe loses, half a step off, half of what the highest side lobe lacks.

    The main lobe's power falls by u^2 times the variance of the places.
    """
    return 2 * math.sqrt((1 - lattice.side_lobe) / 2 * lattice.size / lattice.moment)


def _vertex(left: Floats, right: Floats, fall_left: Floats, fall_right: Floats) -> Floats:
    """Where the parabola through (-left, fall_left), (0, 0) and (right, fall_right) turns."""
    a, b = fall_left * right, fall_right * left
    bend = a + b
    return np.where(bend == 0, 0.0, 0.5 * (a * right - b * left) / np.where(bend == 0, 1.0, bend))


def derivatives(c: NDArray[np.complex128], u: Floats, lattice: Lattice) -> tuple[Floats, Floats, Floats]:
    """Value, slope and curvature (K,) at u (K,) of lag polynomials c (L, K), lags first."""
    terms = phasors(u, lattice.lags)
    terms *= c
    sums: Floats = (lattice.derivative_weights @ terms.view(np.float64)).reshape(3, -1, 2)
    return sums[0, :, 0], sums[1, :, 1], sums[2, :, 0]


def phasors(u: Floats, numbers: Whole) -> NDArray[np.complex128]:
    """exp(j k u) for ascending whole k >= 0, (N, K)."""
    n = int(numbers[-1]) + 1
    if n == len(numbers):
        return powers(u, n)
    if n <= SPARSE * len(numbers):
        return powers(u, n)[numbers]
    out: NDArray[np.complex128] = np.exp(1j * numbers[:, None] * u)
    return out


def powers(u: Floats, n: int) -> NDArray[np.complex128]:
    """exp(j k u) for k = 0 ... n - 1, (n, K), by doubling: far cheaper than as many sines."""
    out = np.empty((n, len(u)), np.complex128)
    out[0] = 1
    step, done = np.exp(1j * u), 1
    while done < n:
        more = min(done, n - done)
        np.multiply(out[:more], step, out=out[done : done + more])
        step, done = step * step, done + more
    return out


def polynomial_table(u: Floats, lags: Whole) -> Floats:
    """(2 L, G) so that interleaved (Re c, Im c) @ table = Re sum_k c_k exp(j k u)."""
    angles = lags[:, None] * u
    table: Floats = np.stack([np.cos(angles), -np.sin(angles)], axis=1).reshape(2 * len(lags), len(u))
    return table
