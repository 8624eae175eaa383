"""Azimuth and elevation by one spectral method: the state of every UE, and what it says of a block's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.elements import lattice, partners
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation import spectra
from chachart.node.estimation.bounds import information_scale, mvdr_excess
from chachart.node.estimation.covariance import Bank, Grouping, covariances
from chachart.node.estimation.directions.board import BoardManifold
from chachart.node.estimation.directions.free import FreeManifold, RingManifold
from chachart.node.estimation.directions.manifold import DirectionManifold
from chachart.node.estimation.directions.sphere import unit
from chachart.node.estimation.factors import Factors
from chachart.node.estimation.locator import Columns
from chachart.node.estimation.options import Options
from chachart.node.estimation.state import SlotState

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

SPECTRUM_AZIMUTHS, SPECTRUM_ELEVATIONS = 181, 91
"""Points each way of the spectra that people look at."""


def manifold_of(array: ArrayGeometry, *, elevation: bool = True) -> DirectionManifold:
    """The manifold of the elements that count, of an array that is no uniform line.

    Without `elevation` azimuth alone is looked for, as of elements on one line anyway.
    """
    if array.is_line or not elevation:
        return RingManifold(array)
    if array.pattern is None and lattice(array.own_elements[array.live_antennas]) is not None:
        return BoardManifold(array)
    return FreeManifold(array)


class DirectionAxis(SlotState):
    """A spectral method on a manifold of directions; what `SpectralAxis` is for one coordinate.

    Parameters
    ----------
    method
        One of `options.SPECTRAL`.
    array
        Any but a uniform line.
    snapshots
        M, snapshots a frame.
    """

    name = "theta"

    def __init__(self, method: str, array: ArrayGeometry, snapshots: int, options: Options) -> None:
        self.method, self.snapshots, self.options = method, snapshots, options
        self.whole = self.manifold = manifold_of(array, elevation=options.elevation)
        n = self.whole.size
        self._parts: NDArray[np.intp] | None = None
        if options.smoothing < 1 and method != "bartlett":
            self._parts, sub = sub_arrays(array, options.smoothing)
            self.manifold = manifold_of(sub, elevation=options.elevation)
        self._partners = partners(array.own_elements[array.live_antennas])
        if self._parts is not None:
            self._partners = partners(self.manifold.waves)
        none = np.zeros((0, n, 1), np.complex64)
        shape = self.whole.features(none, none).shape[1:] if method == "bartlett" else (n, n)
        self._bank = Bank(shape, np.complex64, options.decay)
        super().__init__(bank=self._bank)
        if method != "bartlett":
            self._factors = Factors(method, self.manifold.size, options, self.manifold.corners)
            self.children["factors"] = self._factors

    def of_frames(self, x: Complex) -> Complex:
        """What is kept of each frame, from snapshot matrices x (K, N, M)."""
        return self.whole.features(x, x.conj()) if self.method == "bartlett" else covariances(x)

    def energy(self, kept: Complex) -> NDArray[Any]:
        """Sum of |h|^2 of each frame (K,)."""
        if self.method == "bartlett":
            return self.whole.trace(kept)
        trace: NDArray[Any] = np.einsum("kii->k", kept).real
        return trace

    def take(self, group: Grouping, features: Complex) -> Complex:
        """Take what is kept of a block's frames; returns the sums of its UEs."""
        sums: Complex = self._bank.add(group, features)
        return sums

    def estimate(self, group: Grouping, sums: Complex, weight: Floats, frames: Floats) -> Columns:
        """Estimate a block's UEs from the sums of `take`, as `SpectralAxis` does.

        Besides its columns there are azimuth, elevation, their deviations, and `direction` (U, 3).
        """
        n, snapshots = self.manifold.size, frames * self.snapshots
        scale = weight * (self.snapshots * n)
        steps = self.options.newton_steps
        if self.method == "bartlett":
            d, value = self.manifold.extremum(sums, maximum=True, steps=steps)
            return self._judge(d, self.whole.trace(sums) / scale, value / (scale * n), snapshots)
        r = self._prepared(sums)
        factor = self._factors.of(r, group.slots, snapshots)
        c = self.manifold.features(factor, factor.conj())
        d, value = self.manifold.extremum(c, maximum=self.method in spectra.MAXIMUM, steps=steps)
        d[np.isnan(value)] = np.nan
        steering = self.manifold.steering(d).astype(r.dtype)[:, :, None]
        beam = np.einsum("kni,kni->k", steering.conj(), np.matmul(r, steering)).real
        return self._judge(d, np.einsum("kii->k", r).real / scale, beam / (scale * n), snapshots)

    def spectrum(self, slot: int, frames: float, points: int) -> dict[str, Floats]:
        """Grids and spectra (largest value 1) of azimuth and elevation, each over the other, and of theta."""
        c: Complex = self._bank.rows[[slot]].astype(np.complex128)
        if self.method != "bartlett":
            r = self._prepared(c)
            factor = self._factors.of(r, None, np.array([frames * self.snapshots]))
            c = self.manifold.features(factor, factor.conj())
        d, shape = picture(self.manifold)
        power = (c.reshape(1, -1).view(np.float64) @ self.manifold.table(d))[0]
        if self.method == "music":
            power = self.manifold.size - power
        if self.method != "bartlett":
            power = 1 / np.maximum(power, 1e-12 * power.max())
        return profiles(d, power / power.max(), shape, points)

    def _prepared(self, r: Complex) -> Complex:
        """Covariances (U, N, N) after sub-array smoothing and forward-backward averaging."""
        if self._parts is not None:
            r = np.mean([r[:, part[:, None], part] for part in self._parts], axis=0)
        if self.options.forward_backward and self._partners is not None:
            r = (r + r[:, self._partners[:, None], self._partners].conj()) * r.real.dtype.type(0.5)
        return r

    def _judge(self, d: Floats, total: Floats, beam: Floats, snapshots: Floats) -> Columns:
        """As `SpectralAxis` judges: `total` = tr R / N is P + sigma^2, `beam` = aᴴRa / N^2."""
        n = self.manifold.size
        power = np.maximum((n * beam - total) / (n - 1), total / np.sqrt(n * snapshots))
        noise = np.maximum(total - power, 1e-6 * total)
        snr = power / noise
        quality, information = information_scale(n, snapshots, snr), None
        if self.method == "minnorm":
            information = self.manifold.beam_information(d, self.manifold.corners)
        elif self.method == "mvdr":
            mirrored = 2 if self.options.forward_backward else 1
            quality = quality / mvdr_excess(n, mirrored * snapshots, snr, self.options.loading)
        found: Columns = {"direction": d, "power": power, "noise": noise}
        return found | self.manifold.coordinates(d) | self.manifold.std(d, quality, information)


def sub_arrays(array: ArrayGeometry, span: float) -> tuple[NDArray[np.intp], ArrayGeometry]:
    """The sub-boards that span so much of rows and columns: elements (S, n), and the first as an array.

    Raises
    ------
    ValueError
        If the array is no board.
    """
    own = array.own_elements[array.live_antennas]
    board = lattice(own)
    if board is None:
        raise ValueError("smoothing must be 1: sub-arrays that look alike take a line or a board")
    sizes = [min(max(2, round(span * size)), size) for size in (board.rows, board.columns)]
    number = np.empty((board.rows, board.columns), np.intp)
    number[board.row, board.column] = np.arange(len(own))
    windows = np.lib.stride_tricks.sliding_window_view(number, sizes)
    parts: NDArray[np.intp] = windows.reshape(-1, sizes[0] * sizes[1])
    first = tuple((float(x), float(y), float(z)) for x, y, z in own[parts[0]])
    seen = array.sees or ("front" if array.facing is not None else "all")
    sub = replace(array, antennas=len(first), elements=first, sees=seen, calibration=None, dead_antennas=())
    return parts, sub


def picture(manifold: DirectionManifold) -> tuple[Floats, tuple[int, int]]:
    """Directions of a grid of azimuths and elevations that are searched, and its shape."""
    azimuth = np.radians(np.linspace(-180, 180, 2 * SPECTRUM_AZIMUTHS - 1))
    flat = isinstance(manifold, RingManifold)
    elevation = np.zeros(1) if flat else np.radians(np.linspace(-90, 90, SPECTRUM_ELEVATIONS))
    if manifold.facing is not None and manifold.facing[2] > 0.5:
        azimuth = azimuth[np.abs(azimuth) <= np.pi / 2 + 1e-9]
    if manifold.facing is not None and abs(manifold.facing[1]) > 0.5:
        elevation = elevation[elevation * manifold.facing[1] >= -1e-9]
    d = unit(azimuth, elevation[:, None])
    return d.reshape(-1, 3), (len(elevation), len(azimuth))


def profiles(d: Floats, power: Floats, shape: tuple[int, int], points: int) -> dict[str, Floats]:
    """Largest power by azimuth, by elevation and by theta, of power (P,) in the directions of `picture`."""
    square = power.reshape(shape)
    azimuth = np.arctan2(d[:, 0], d[:, 2]).reshape(shape)[shape[0] // 2]
    theta = np.arccos(np.clip(d[:, 0], -1, 1))
    grid = np.linspace(0, np.pi, min(points, SPECTRUM_AZIMUTHS))
    nearest = np.rint(theta / (grid[1] - grid[0])).astype(np.intp)
    by_theta = np.zeros(len(grid))
    np.maximum.at(by_theta, nearest, power)
    known = by_theta > 0
    by_theta = np.interp(grid, grid[known], by_theta[known])
    found = {"theta_grid_rad": grid, "theta_spectrum": by_theta}
    found |= {"azimuth_grid_rad": azimuth, "azimuth_spectrum": square.max(axis=0)}
    if shape[0] > 1:
        elevation = np.arcsin(np.clip(d[:, 1], -1, 1)).reshape(shape)[:, 0]
        found |= {"elevation_grid_rad": elevation, "elevation_spectrum": square.max(axis=1)}
    return found
