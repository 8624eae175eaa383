"""Which peak of an angle-delay spectrum over directions is the direct path: `direct_path`'s rule."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.direct_path import (
    ANGLE_SPREAD,
    CROWDING,
    DELAY_SPREAD_M,
    FALSE_ALARM_DEVIATE,
    FLOOR_POINTS,
    LEAST_NOISE,
    LEAST_PEAK,
    SIDE_LOBE_MARGIN,
    SPREAD_DOUBT,
    gamma_quantile,
    lobes,
    of_each,
)
from chachart.node.estimation.directions.paths import pursue, waves
from chachart.node.estimation.directions.spectrum import AngleDelaySpectrum, Csi, Power
from chachart.node.estimation.locator import Columns
from chachart.node.estimation.periodogram import energy

Floats = NDArray[np.float64]
Index = NDArray[np.intp]

DOUBT = 1 + 2 * 1.25 / np.sqrt(FLOOR_POINTS)
"""What is left beside a path counts as echoes where it is more than so many times the noise's level."""
SURE = 1 + 4 * 1.25 / np.sqrt(FLOOR_POINTS)
"""From so many times the noise's level on, it is worth the time to tell paths apart."""
REFINEMENTS = 6
"""Newton steps from the grid: its maximum is up to a quarter of a cell off, in each of three coordinates."""


class DirectionPath:
    """Finds the direct path in frames of one array.

    Parameters
    ----------
    array, rho_max_m, elevation
        As of `AngleDelaySpectrum`.
    paths
        Where there are echoes, so many paths in all are told apart, see `paths.pursue`.
    """

    def __init__(
        self, array: ArrayGeometry, rho_max_m: float, *, elevation: bool = True, paths: int = 1
    ) -> None:
        self.paths = paths
        self.spectrum = AngleDelaySpectrum(array, rho_max_m, elevation=elevation)
        s = self.spectrum
        self.delay, self.manifold = s.delay, s.manifold
        self._elements = s.manifold.size * s.tones.size
        d = s.delays
        self._v = 2 * np.pi / d * np.arange(d)
        lag = np.arange(d)[:, None] - np.arange(d)  # [of the other path, of the candidate]
        cell_m = array.unambiguous_rho_m / s.tones.span
        cost = lag % d * (array.unambiguous_rho_m / d / max(DELAY_SPREAD_M, cell_m))
        self._delay_cost = cost.astype(np.float32)
        turn = np.linalg.norm(s.points[:, None] - s.points, axis=2)
        self._angle_cost = (turn / max(ANGLE_SPREAD, s.manifold.cell / 2)).astype(np.float32)
        a = s.manifold.steering(s.points)
        gain = np.abs(a.conj() @ a.T) ** 2 / s.manifold.size**2
        gain = gain[:, s.neighbours].max(axis=2)[s.neighbours].max(axis=1)  # the path is between grid points
        by_delay = lobes(s.tones, d)
        by_delay = np.maximum(by_delay, np.maximum(np.roll(by_delay, 1), np.roll(by_delay, -1)))
        self._lobes = gain.astype(np.float32), by_delay
        step = 2 * np.pi / d
        self._step_s = array.unambiguous_rho_m / d / array.light_speed_m_s
        self._allowed: NDArray[np.bool_] = (self._v <= -self.delay.low + step) | (
            self._v >= 2 * np.pi - 1.5 * step
        )
        self._stride = max(len(s.points) * d // FLOOR_POINTS, 1) | 1
        own = array.own_elements[array.live_antennas]
        tone = float(np.var(s.tones.index))
        step_hz = -self.delay.phase * array.light_speed_m_s / (2 * np.pi)
        self._squint = (step_hz / array.middle_hz) ** 2 * tone * s.manifold.waves.T @ s.manifold.waves
        self._squint /= s.manifold.size
        self._bend = np.pi / array.wavelength_m * float(np.std((own**2).sum(axis=1)))
        self._reach_m = float(np.ptp(own, axis=0).max())

    def find(self, frames: Csi, gain: Floats) -> Columns:
        """The direct paths in frames (U, N_R, N_S), sums of `gain` (U,) frames at the noise level of one.

        Besides theta, rho and directions with their deviations there are, per element of a frame: `power` of
        the path, `noise` with all other paths, and `floor`, the noise alone. SNR is that of one frame; the
        delay spread is that of all peaks of the spectrum.
        """
        s, n = self.spectrum, self._elements
        parts = [self._coarse(frames[at : at + s.chunk]) for at in range(0, len(frames), s.chunk)]
        point, v, floor, spread = (np.concatenate(values) for values in zip(*parts, strict=True))
        d, v, top = s.refine(frames, s.points[point], v, REFINEMENTS)
        total = energy(frames.reshape(len(frames), -1))
        least = LEAST_NOISE * total / n
        rest = np.maximum((total - top / n) / (n - 1), least)
        noise = np.clip(floor / n, least, rest)
        rest = np.maximum(rest - self._spread(d, v) * top / n**2, SPREAD_DOUBT * noise)
        noise = np.minimum(noise, rest)
        path = np.maximum(top / n - noise, 1e-3 * noise)
        echoes = np.maximum(rest - DOUBT * noise, 0)
        crowd = np.flatnonzero(rest > SURE * noise)
        if self.paths > 1 and len(crowd):
            apart = pursue(s, frames[crowd], d[crowd], v[crowd], self.paths, self._allowed)
            d[crowd], v[crowd] = apart.direction[:, 0], apart.v[:, 0]
            path[crowd] = np.maximum(n * apart.power[:, 0], 1e-3 * noise[crowd])
            left = (frames[crowd] - waves(s, apart)).astype(np.complex64)
            left_noise = energy(left.reshape(len(crowd), -1)) / (n - self.paths)
            echoes[crowd] = np.maximum(left_noise - DOUBT * noise[crowd], 0)
        error = noise * (1 + noise / path) + CROWDING * echoes
        variance = self.spectrum.tones.moment / self.spectrum.tones.size
        v_std = np.sqrt(error / (2 * path * variance))
        rho = self.delay.coordinate(-self._within(v, v_std))
        quality = 2 * path / error / self.manifold.size
        return {
            "direction": d,
            **self.manifold.coordinates(d),
            **self.manifold.std(d, quality),
            "rho": rho,
            "rho_std": self.delay.coordinate_std(-v, v_std),
            "power": path / n,
            "noise": rest,
            "floor": noise,
            "delay_spread": spread,
            "snr": 10 * np.log10(path / n / (rest + (gain - 1) * noise)),
        }

    def apart(self, frames: Csi, gain: Floats) -> dict[str, Floats]:
        """The direct path and the strongest others of one frame (1, N_R, N_S), as `paths` says how many.

        `path_theta`, `path_azimuth`, `path_elevation` (rad), `path_rho_m` and `path_power_db`, relative to
        the strongest, (L,) each.
        """
        at = self.find(frames, gain)
        v = -self.delay.u(at["rho"])
        found = pursue(self.spectrum, frames, at["direction"], v, self.paths, self._allowed)
        power = found.power[0]
        angles = self.manifold.coordinates(found.direction[0])
        rho = self.delay.coordinate(-(found.v[0] % (2 * np.pi)))
        decibel = 10 * np.log10(np.maximum(power / power.max(), 1e-30))
        named = {f"path_{name}": values for name, values in angles.items()}
        return named | {"path_rho_m": rho, "path_power_db": decibel}

    def _coarse(self, frames: Csi) -> tuple[Index, Floats, Floats, Floats]:
        """Grid direction, delay, noise level and rms delay spread in s, (U,) each, of the direct paths."""
        power = self.spectrum.of(frames)
        floor = self._floor(power)
        cell, spread = self._select(power, self._peaks(power, floor), floor)
        i, j = np.divmod(cell, self.spectrum.delays)
        return i, self._v[j] + self._vertex(power, i, j), floor, spread * self._step_s

    def _floor(self, power: Power) -> Floats:
        """Noise level (U,), from the median of some points: most of the plane holds no path."""
        some = power.reshape(len(power), -1)[:, :: self._stride]
        middle = some.shape[1] // 2
        median: Floats = np.partition(some, middle, axis=1)[:, middle].astype(np.float64)
        return median / gamma_quantile(np.ones(len(power)), 0.0)

    def _peaks(self, power: Power, floor: Floats) -> Index:
        """Flat indices, ascending, of maxima that noise would rarely reach; for each UE at least one."""
        k, points, delays = power.shape
        flat = power.reshape(-1)
        level = np.maximum(
            floor * gamma_quantile(np.ones(k), FALSE_ALARM_DEVIATE),
            LEAST_PEAK * power.reshape(k, -1).max(axis=1),
        )
        above = power >= level.astype(np.float32)[:, None, None]
        above &= self._allowed
        cells = np.flatnonzero(above)
        row, delay = np.divmod(cells, delays)
        height = flat[cells]
        base = row * delays
        later, earlier = base + (delay + 1) % delays, base + (delay - 1) % delays
        keep = (height >= flat[later]) & (height > flat[earlier])
        cells, row, delay, height = cells[keep], row[keep], delay[keep], height[keep]
        ue, point = np.divmod(row, points)
        around = flat[(ue[:, None] * points + self.spectrum.neighbours[point]) * delays + delay[:, None]]
        cells = cells[(around <= height[:, None]).all(axis=1)]
        lost = np.flatnonzero(np.bincount(cells // (points * delays), minlength=k) == 0)
        if len(lost):
            best = np.where(self._allowed, power[lost], 0).reshape(len(lost), -1).argmax(axis=1)
            cells = np.sort(np.concatenate([cells, lost * (points * delays) + best]))
        return cells

    def _select(self, power: Power, peaks: Index, floor: Floats) -> tuple[Index, Floats]:
        """The direct path's grid point (U,), flat within its spectrum, among the peaks of all spectra.

        And the rms spread (U,) of all peaks' delays about it, in grid steps.
        """
        k, points, d = power.shape
        ue, cell = np.divmod(peaks, points * d)
        i, j = np.divmod(cell, d)
        height = power.reshape(-1)[peaks]
        first = np.searchsorted(ue, np.arange(k))
        highest = np.maximum.reduceat(height, first)[ue]
        strongest = of_each(ue, height == highest, k)[ue]
        lobe = self._lobes[0][i, i[strongest]] * self._lobes[1][(j - j[strongest]) % d]
        net = np.maximum(height - floor.astype(np.float32)[ue], np.float32(1e-3) * height)
        net[height < np.minimum(SIDE_LOBE_MARGIN * lobe, 1) * highest] = 0
        share = net / np.add.reduceat(net, first)[ue]
        delays = np.bincount(ue * d + j, share, k * d).reshape(k, d).astype(np.float32)
        angles = np.bincount(ue * points + i, share, k * points).reshape(k, points).astype(np.float32)
        score = np.log(np.maximum(share, np.float32(1e-30)))
        score -= (delays @ self._delay_cost)[ue, j]
        score -= (angles @ self._angle_cost)[ue, i]
        best: Index = cell[of_each(ue, score == np.maximum.reduceat(score, first)[ue], k)]
        after = (j - (best % d)[ue] + d // 2) % d - d // 2
        mean, square = (np.add.reduceat(share * after**order, first) for order in (1, 2))
        return best, np.sqrt(np.maximum(square - mean**2, 0)).astype(np.float64)

    def _vertex(self, power: Power, i: Index, j: Index) -> Floats:
        """How far from the grid's delay the parabola through the logarithms of three neighbours peaks."""
        rows = power[np.arange(len(i)), i]
        three = [rows[np.arange(len(i)), (j + step) % self.spectrum.delays] for step in (-1, 0, 1)]
        left, middle, right = np.log(np.maximum(three, np.finfo(np.float32).tiny))
        curvature = np.minimum(left - 2 * middle + right, np.float32(-1e-6))
        shift = np.clip((left - right) / curvature / 2, -0.5, 0.5)
        return np.asarray(shift * (2 * np.pi / self.spectrum.delays), np.float64)

    def _spread(self, d: Floats, v: Floats) -> Floats:
        """Share (U,) of a path's power beside its peak, for being no plane wave of a single frequency."""
        squint = ((d @ self._squint) * d).sum(axis=1)
        bend = self._bend / np.maximum(self.delay.coordinate(v % (2 * np.pi)), self._reach_m)
        spread: Floats = squint + bend**2
        return spread

    def _within(self, v: Floats, v_std: Floats) -> Floats:
        """v in the searched range; a little below 0, it is noise about 0 rather than the circle's far end."""
        v = v % (2 * np.pi)
        far = -self.delay.low
        slack = np.minimum(3 * v_std, np.pi / self.spectrum.tones.span)
        zero = 2 * np.pi - v < np.maximum(slack, v - far)
        within: Floats = np.where(zero, 0, np.minimum(v, far))
        return within
