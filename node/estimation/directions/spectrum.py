"""Angle-delay spectra of arrays that are no uniform line, and the exact matched filter behind them.

The spectrum of a frame H (N_R, N_S) is P(d, v) = |aᴴ(d) y(v)|^2, y(v) = sum_n H_n exp(j v t_n) over the tones
t_n, v = 2 pi spacing / c rho: on a grid of directions, by one matrix product, and of delays, by FFT. Off the
grid, P and its derivatives follow from the frame itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.directions.axis import manifold_of
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.manifold import DelayManifold

Csi = NDArray[np.complex64]
Power = NDArray[np.float32]
Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

PER_CELL = 2
"""Grid points per resolution cell: the least that a spectrum of its bandwidth is known by."""
PER_CELL_IN_SPACE = 4
"""For elements in no plane, whose side lobes may be nearly as high as the main one: that must not fall
between grid points."""
NEIGHBOUR = 1.6
"""Directions so many grid steps apart are neighbours."""
CONVERGED = 1e-4
"""In quarters of a resolution cell: after a step as small, Newton's error is of the order of its square."""
_CHUNK_BYTES = 1 << 21


class AngleDelaySpectrum:
    """P of frames of one array.

    Parameters
    ----------
    array
        Any array; of a uniform line directions are those of its own plane.
    rho_max_m
        Farthest range that is searched.
    elevation
        Whether elevations are searched, too.

    Attributes
    ----------
    manifold, delay
        Of the elements, and of the tones.
    points
        (G, 3): the grid's directions.
    delays
        D, points on the circle of v: 2 pi j / D.
    neighbours
        intp (G, W): of each direction, itself in place of missing ones.
    chunk
        How many spectra are best worked on at a time.
    """

    def __init__(self, array: ArrayGeometry, rho_max_m: float, *, elevation: bool = True) -> None:
        self.manifold = manifold_of(array, elevation=elevation)
        self.delay = DelayManifold.of(array, rho_max_m)
        self.tones: Lattice = self.delay.lattice
        self.points, places = self.manifold.grid(PER_CELL if self.manifold.flat else PER_CELL_IN_SPACE)
        self.delays = int(fft.next_fast_len(PER_CELL * self.tones.span))
        self._beams = self.manifold.steering(self.points).conj().astype(np.complex64)
        apart = np.linalg.norm(places[:, None] - places, axis=2)
        near = apart < NEIGHBOUR
        width = int(near.sum(axis=1).max())
        nearest = np.argsort(apart, axis=1)[:, :width]
        inside = np.take_along_axis(near, nearest, axis=1)
        self.neighbours: NDArray[np.intp] = np.where(inside, nearest, nearest[:, :1])
        self.chunk = max(_CHUNK_BYTES // (8 * len(self.points) * self.delays), 1)

    def of(self, frames: Csi) -> Power:
        """P (K, G, D) of frames (K, N_R, N_S)."""
        placed = self.tones.spread_out(frames, 2)
        y = fft.ifft(placed, self.delays, axis=2, norm="forward")
        beams = np.matmul(self._beams, y)
        power: Power = np.square(beams.real)
        power += np.square(beams.imag)
        return power

    def moments(self, frames: Csi, v: Floats) -> Complex:
        """(K, N, 3): y and its first two derivatives at v (K,), tones counted from their middle."""
        t = self.tones.centred
        turn = np.exp(1j * v[:, None] * t)
        weights = np.stack([turn, 1j * t * turn, -t * t * turn], axis=2)
        y: Complex = np.matmul(frames, weights.astype(np.complex64)).astype(np.complex128)
        return y

    def derivatives(self, frames: Csi, d: Floats, v: Floats, e: Floats) -> tuple[Floats, Floats, Floats]:
        """P (K,), its slope (K, 3) and curvature (K, 3, 3) by steps along e (2, K, 3) and in v."""
        a = self.manifold.steering_derivatives(d, e)
        g = np.matmul(a.conj(), self.moments(frames, v))
        first = np.stack([g[:, 1, 0], g[:, 2, 0], g[:, 0, 1]], axis=1)
        second = np.empty((len(g), 3, 3), np.complex128)
        for i, j, value in (
            (0, 0, g[:, 3, 0]),
            (0, 1, g[:, 4, 0]),
            (1, 1, g[:, 5, 0]),
            (0, 2, g[:, 1, 1]),
            (1, 2, g[:, 2, 1]),
            (2, 2, g[:, 0, 2]),
        ):
            second[:, i, j] = second[:, j, i] = value
        top = g[:, 0, 0]
        slope = 2 * (top.conj()[:, None] * first).real
        bend = 2 * (first.conj()[:, :, None] * first[:, None] + top.conj()[:, None, None] * second).real
        return np.abs(top) ** 2, slope, bend

    def refine(self, frames: Csi, d: Floats, v: Floats, steps: int) -> tuple[Floats, Floats, Floats]:
        """d, v and P at its maxima next to d (K, 3) and v (K,), by Newton steps that never lead down.

        A step that would is taken back, and the next ones are a quarter as long.
        """
        limits = np.array([self.manifold.cell, self.manifold.cell, 2 * np.pi / self.tones.span]) / 4
        room = np.ones(len(d))
        best_d, best_v, top = d, v, np.full(len(d), -1.0)
        step = np.zeros((3, len(d)))
        for _ in range(steps):
            value, slope, bend = self.derivatives(frames, d, v, self.manifold.ways(d))
            up = value >= top
            top = np.where(up, value, top)
            best_d, best_v = np.where(up[:, None], d, best_d), np.where(up, v, best_v)
            room = np.where(up, room, room / 4)
            fresh = ascent(slope * limits, bend * np.outer(limits, limits)) * np.minimum(1, room)
            step = np.where(up, fresh, step / 4)
            moves = step * limits[:, None]
            d = self.manifold.moved(best_d, self.manifold.ways(best_d), moves[:2])
            v = best_v + moves[2]
            if np.abs(step).max() < CONVERGED:
                break
        return d, v, top


def ascent(slope: Floats, bend: Floats) -> Floats:
    """Steps (3, K) to a maximum, of at most 1 each, from slope (K, 3) and curvature (K, 3, 3).

    Uphill where the curvature is not negative; a way without slope and curvature is not gone.
    """
    (a, b, c), (_, d, e), (_, _, f) = -bend.transpose(1, 2, 0)
    size = np.maximum(np.maximum(a, d), np.maximum(f, 1e-300))
    d = np.where(np.abs(b) + np.abs(d) + np.abs(e) == 0, size, d)
    x, y, z = slope.T
    minors = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * minors[0] + b * minors[1] + c * minors[2]
    sound = (a > 0) & (a * d - b * b > 0) & (det > 0)
    det = np.where(sound, det, 1)
    newton = np.stack(
        [
            minors[0] * x + minors[1] * y + minors[2] * z,
            minors[1] * x + (a * f - c * c) * y + (b * c - a * e) * z,
            minors[2] * x + (b * c - a * e) * y + (a * d - b * b) * z,
        ]
    )
    length = np.maximum(np.sqrt(x * x + y * y + z * z), 1e-300)
    step = np.where(sound, newton / det, np.stack([x, y, z]) / length)
    step /= np.maximum(np.abs(step).max(axis=0), 1)
    return step
