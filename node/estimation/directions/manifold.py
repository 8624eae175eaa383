"""What arrays that are no uniform line have in common: directions, steering vectors, and the search.

A direction is a unit vector d along (right, up, normal), so that there are no poles to fall over; element n
at position p_n has the phase 2 pi / wavelength p_n . d. aᴴQa is searched on a grid by one real matrix
product, and from the best point by Newton steps. Elements in a plane see no more of d than its projection
on that plane: the steps are in that projection, of which phases are linear, and d is on one side of the
plane. Other arrays' steps are along two vectors tangent to the sphere: s leads from d to d cos|s| + (e_1
s_1 + e_2 s_2) sin|s| / |s|.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.elements import mirror
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.directions.algebra import congruent, inverse, newton_step, packed
from chachart.node.estimation.directions.sphere import moved, tangents

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

PER_CELL = 4
"""Grid points per resolution cell, each way."""
CONVERGED = 1e-5
"""In resolution cells: after a step as small, Newton's error is of the order of its square."""
GAIN_STEP = 1e-4
"""In rad: over which differences of patterns are taken."""
LEAST_INFORMATION = 12 / np.pi**2
"""What is known of an angle beforehand: it lies within half a turn."""


class DirectionManifold(ABC):
    """Steering vectors a(d) of N elements, |a|^2 = N, over the directions where UEs may be.

    Parameters
    ----------
    array
        Its elements that count, at the middle of its band.

    Attributes
    ----------
    size
        N.
    waves
        (N, 3): element positions from the array's middle in radians, 2 pi / wavelength p.
    facing
        Unit vector into the half of all directions that is searched, or None.
    plane
        Unit normal of the plane of the elements, on the side that is searched; None if they are in none.
    points
        (G, 3): the grid's directions.
    cell
        Resolution in radians, wavelength over extent.
    corners
        intp (C,): elements at the array's outer ends, for Min-Norm.
    """

    size: int
    points: Floats

    def __init__(self, array: ArrayGeometry) -> None:
        own = array.own_elements[array.live_antennas]
        self.size = len(own)
        wavelength = array.light_speed_m_s / array.middle_hz
        self.waves = 2 * np.pi / wavelength * own
        self.facing = array.facing
        self._pattern = array.pattern
        self._live = np.flatnonzero(array.live_antennas)
        # elements with patterns of their own tell the two sides of their plane apart
        self.plane = None if array.pattern is not None else _side(mirror(own), self.facing)
        self._axes = None if self.plane is None else tangents(self.plane[None])
        reach = float(np.linalg.norm(own[:, None] - own, axis=2).max())
        self.cell = min(wavelength / max(reach + wavelength / 4, 1e-9), np.pi / 2)
        centred = self.waves - self.waves.mean(axis=0)
        self._scatter = centred.T @ centred
        ends = [pick for axis in centred.T if np.ptp(axis) > 0 for pick in (axis.argmin(), axis.argmax())]
        self.corners: NDArray[np.intp] = np.unique(ends)
        self._tables: dict[np.dtype[Any], NDArray[Any]] = {}

    @abstractmethod
    def grid(self, per_cell: float) -> tuple[Floats, Floats]:
        """Directions (G, 3) with so many points a resolution cell each way, and where they are, (G, ...).

        The latter is in steps of the grid: neighbours are 1 to 1.5 apart.
        """

    @abstractmethod
    def features(self, x: Complex, conjugate: Complex) -> Complex:
        """What the spectrum aᴴQa follows from, (K, ...), of Q = X Xᴴ for factors x (K, N, M)."""

    @abstractmethod
    def of_matrices(self, q: Complex) -> Complex:
        """The same of Hermitian matrices q (K, N, N)."""

    @abstractmethod
    def trace(self, features: Complex) -> NDArray[Any]:
        """tr Q (K,)."""

    @abstractmethod
    def table(self, points: Floats) -> Floats:
        """(2 L, G) so that interleaved (Re, Im) of features (K, L) @ table = aᴴQa at points (G, 3)."""

    @abstractmethod
    def derivatives(self, features: Complex, d: Floats, e: Floats) -> tuple[Floats, Floats, Floats]:
        """aᴴQa (K,), its slope (2, K) and curvature (3, K: 11, 12, 22) at d (K, 3) by steps along e.

        e (2, K, 3) are the tangents of `ways`.
        """

    def steering(self, d: Any) -> NDArray[np.complex128]:
        """Steering vectors (..., N) in own directions d (..., 3), as elements measure waves from there."""
        d = np.asarray(d, np.float64)
        a: NDArray[np.complex128] = np.exp(1j * (d @ self.waves.T))
        if self._pattern is not None:
            a *= self.gains(d.reshape(-1, 3)).reshape(a.shape)
        return a

    def gains(self, d: Floats) -> NDArray[np.complex128]:
        """Patterns (K, N) of the elements in directions d (K, 3), |g|^2 = N together."""
        assert self._pattern is not None
        g = self._pattern.gains(d)[:, self._live]
        size = np.linalg.norm(g, axis=1, keepdims=True)
        scaled: NDArray[np.complex128] = g * (np.sqrt(self.size) / np.maximum(size, 1e-12))
        return scaled

    def steering_derivatives(self, d: Floats, e: Floats) -> NDArray[np.complex128]:
        """(K, 6, N): a, a_1, a_2, a_11, a_12, a_22, its derivatives by steps along `ways` e (2, K, 3)."""
        phase, p, q = (vectors @ self.waves.T for vectors in (d, *e))
        bend = 0.0 if self.flat else 1j * phase
        out = np.empty((len(d), 6, self.size), np.complex128)
        a = np.exp(1j * phase)
        out[:, 0], out[:, 1], out[:, 2] = a, 1j * p * a, 1j * q * a
        out[:, 3] = -(p * p + bend) * a
        out[:, 4] = -(p * q) * a
        out[:, 5] = -(q * q + bend) * a
        return out if self._pattern is None else self._with_gains(out, d, e)

    def _with_gains(self, waves: NDArray[np.complex128], d: Floats, e: Floats) -> NDArray[np.complex128]:
        """Derivatives of waves times gains; the smooth gains' own by central differences."""
        h = GAIN_STEP
        g = {
            (i, j): self.gains(moved(d, e, h * np.stack([np.full(len(d), i), np.full(len(d), j)])))
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        }
        one, two = (g[1, 0] - g[-1, 0]) / (2 * h), (g[0, 1] - g[0, -1]) / (2 * h)
        g11 = (g[1, 0] - 2 * g[0, 0] + g[-1, 0]) / h**2
        g22 = (g[0, 1] - 2 * g[0, 0] + g[0, -1]) / h**2
        g12 = (g[1, 1] - g[1, -1] - g[-1, 1] + g[-1, -1]) / (4 * h**2)
        a, a1, a2, a11, a12, a22 = waves.transpose(1, 0, 2)
        g0 = g[0, 0]
        return np.stack(
            [
                g0 * a,
                one * a + g0 * a1,
                two * a + g0 * a2,
                g11 * a + 2 * one * a1 + g0 * a11,
                g12 * a + one * a2 + two * a1 + g0 * a12,
                g22 * a + 2 * two * a2 + g0 * a22,
            ],
            axis=1,
        )

    @property
    def flat(self) -> bool:
        """Whether steps are in the projection on a plane, where phases are linear."""
        return self._axes is not None

    def ways(self, d: Floats) -> Floats:
        """(2, K, 3): the two unit vectors along which one steps from d (K, 3)."""
        return tangents(d) if self._axes is None else np.broadcast_to(self._axes, (2, len(d), 3))

    def moved(self, d: Floats, e: Floats, step: Floats) -> Floats:
        """Where steps (2, K) along e (2, K, 3) lead from d (K, 3), but not beyond what is searched."""
        if self.plane is None:
            return self.within(moved(d, e, step))
        w = d - (d @ self.plane)[:, None] * self.plane + step[0][:, None] * e[0] + step[1][:, None] * e[1]
        size = np.linalg.norm(w, axis=1)
        w /= np.maximum(size, 1)[:, None]
        return self.within(w + np.sqrt(np.maximum(1 - size * size, 0))[:, None] * self.plane)

    def spectrum(self, features: Complex) -> NDArray[Any]:
        """aᴴQa (K, G) at `points`: one real matrix product."""
        real = features.real.dtype
        if real not in self._tables:
            self._tables[real] = self.table(self.points).astype(real)
        values: NDArray[Any] = features.reshape(len(features), -1).view(real) @ self._tables[real]
        return values

    def extremum(self, features: Complex, *, maximum: bool, steps: int = 4) -> tuple[Floats, Floats]:
        """Where aᴴQa of features (K, ...) is largest or least: directions (K, 3), and values there (K,)."""
        values = self.spectrum(features)
        best = values.argmax(axis=1) if maximum else values.argmin(axis=1)
        d = self.points[best]
        if not steps:
            return d, values[np.arange(len(best)), best].astype(np.float64)
        exact = features.astype(np.complex128)
        limit, sign = self.cell / PER_CELL, -1.0 if maximum else 1.0
        for _ in range(steps):
            e = self.ways(d)
            value, slope, bend = self.derivatives(exact, d, e)
            step = newton_step(sign * slope, sign * bend, limit)
            gain = (slope * step).sum(axis=0) / 2
            d = self.moved(d, e, step)
            if np.abs(step).max() < CONVERGED * self.cell:
                break
        return d, value + gain

    def within(self, d: Floats) -> Floats:
        """d, or where it is outside of the half that is searched the nearest direction on its edge."""
        if self.facing is None:
            return d
        depth = np.minimum(d @ self.facing, 0)
        if not depth.any():
            return d
        inside = d - depth[:, None] * self.facing
        nearest: Floats = inside / np.linalg.norm(inside, axis=1, keepdims=True)
        return nearest

    def coordinates(self, d: Floats) -> dict[str, Floats]:
        """theta, azimuth and elevation (K,) in rad of directions d (K, 3)."""
        right, up, normal = d.T
        return {
            "theta": np.arccos(np.clip(right, -1, 1)),
            "azimuth": np.arctan2(right, normal),
            "elevation": np.arcsin(np.clip(up, -1, 1)),
        }

    def std(self, d: Floats, quality: Floats, information: Floats | None = None) -> dict[str, Floats]:
        """Standard deviations of `coordinates`, in rad.

        Parameters
        ----------
        d
            (K, 3) directions.
        quality
            (K,): what multiplies `information` to the Fisher information, see `bounds.information_scale`.
        information
            (3, K: 11, 12, 22) along growing azimuth and elevation; that of the bound itself where it is None.
        """
        across, upwards = compass(d)
        if information is None:
            information = self.information(d, np.stack([across, upwards]))
        information = quality * information
        if self.plane is not None:
            information = information + self._edge(d, across, upwards, quality)
        information[[0, 2]] += LEAST_INFORMATION
        c = inverse(information)
        along = across[:, 0], upwards[:, 0]
        theta = along[0] ** 2 * c[0] + 2 * along[0] * along[1] * c[1] + along[1] ** 2 * c[2]
        sine, flat = np.sqrt(np.maximum(1 - d[:, 0] ** 2, 0)), np.hypot(d[:, 0], d[:, 2])
        return {
            "theta_std": _wide(theta, sine),
            "azimuth_std": _wide(c[0], flat),
            "elevation_std": np.sqrt(c[2]),
        }

    def beam_information(self, d: Floats, ends: NDArray[np.intp]) -> Floats:
        """`information` (3, K) along azimuth and elevation for Min-Norm with the elements `ends` fixed.

        To first order the null's step solves Eᴴ P (D s - sqrt(N) ds) = 0 in least squares, E picking
        `ends`, P projecting off a, D the slopes of a, and ds the signal vector's error, white off a.
        """
        a = self.steering_derivatives(d, np.stack(compass(d)))[:, :3]
        part = a[:, 0].conj() / self.size
        slopes = a[:, 1:] - np.einsum("kin,kn->ki", a[:, 1:], part)[:, :, None] * a[:, :1]
        b, s = slopes[:, :, ends], a[:, 0, ends] / np.sqrt(self.size)
        across = np.einsum("kie,ke->ki", b.conj(), s)
        plain = np.einsum("kie,kje->kij", b.conj(), b).real
        noise = plain - (across[:, :, None] * across[:, None].conj()).real
        first, second = (packed(m) for m in (plain, noise))
        return congruent(first, inverse(second))

    def information(self, d: Floats, e: Floats) -> Floats:
        """(3, K: 11, 12, 22): sum over the elements of what their phases' derivatives along e deviate by."""
        if self._pattern is not None:
            a = self.steering_derivatives(d, e)[:, :3]
            slopes = (
                a[:, 1:] - np.einsum("kin,kn->ki", a[:, 1:], a[:, 0].conj() / self.size)[..., None] * a[:, :1]
            )
            return packed(np.einsum("kin,kjn->kij", slopes.conj(), slopes).real)
        p = e @ self._scatter
        return np.stack([(p[0] * e[0]).sum(1), (p[0] * e[1]).sum(1), (p[1] * e[1]).sum(1)])

    def _edge(self, d: Floats, across: Floats, upwards: Floats, quality: Floats) -> Floats:
        """Information (3, K) that a plane array's bend gives where its slope vanishes, on its own plane.

        Along its plane d changes by the cosine of the angle to it: with slope c = |d . plane| information is
        c^2 I, and no less than sqrt(I), as for theta near the axis of a line.
        """
        assert self.plane is not None
        depth = d @ self.plane
        flat = d - depth[:, None] * self.plane
        strength = quality * ((flat @ self._scatter) * flat).sum(axis=1)
        more = np.sqrt(strength) - np.minimum(depth**2 * strength, np.sqrt(strength))
        towards = self.plane - depth[:, None] * d
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
        x, y = (towards * across).sum(axis=1), (towards * upwards).sum(axis=1)
        added: Floats = more * np.stack([x * x, x * y, y * y])
        return added


def _side(normal: Floats | None, facing: Floats | None) -> Floats | None:
    """The normal of the plane on the side that is searched; of a plane that stands on it, the usual side."""
    if normal is None or facing is None:
        return normal
    along = float(normal @ facing)
    return normal if along > 1e-6 or (abs(along) <= 1e-6 and abs(normal[1]) < 0.999) else -normal


def compass(d: Floats) -> tuple[Floats, Floats]:
    """Unit tangents (K, 3) in which azimuth and elevation grow."""
    azimuth = np.arctan2(d[:, 0], d[:, 2])
    sine = np.clip(d[:, 1], -1, 1)
    cosine = np.sqrt(1 - sine * sine)
    across = np.stack([np.cos(azimuth), np.zeros(len(d)), -np.sin(azimuth)], axis=1)
    upwards = np.stack([-sine * np.sin(azimuth), cosine, -sine * np.cos(azimuth)], axis=1)
    return across, upwards


def _wide(variance: Floats, slope: Floats) -> Floats:
    """Deviation of an angle whose arc has `variance` and shrinks by `slope`, bounded by its own spread."""
    arc = np.sqrt(variance)
    return np.minimum(arc / np.maximum(slope, np.sqrt(arc)), np.pi)
