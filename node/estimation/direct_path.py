"""Which peak of an angle-delay spectrum is the direct path, and exactly where it is.

The local maxima of the spectrum above its noise are the candidates: paths of power p_k, delay tau_k and
direction cosine c_k. The direct path is taken to be the one with the best

    log p_l - sum_k w_k ((tau_k - tau_l) mod T) / t_0 - sum_k w_k |c_k - c_l| / c_0,     w = p / sum(p),

that is: strong, soon followed by the rest, and amid the directions that the rest come from. Delays are taken
round the circle of unambiguous ones: most errors of a rule that wants the earliest peak are late echoes that
wrap round, and pass for early ones. A path with more than half of the power can not lose by the third term.
t_0 and c_0 are one resolution cell but no less than what scattering makes of an echo; results hardly change
over a factor of two either way.

It is refined off the grid by a parabola through the logarithms, then by one Newton step on the spectrum.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.candidates import Candidates, log
from chachart.node.estimation.judge import alone, inflated, judge, probability
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.locator import Columns
from chachart.node.estimation.manifold import AngleManifold, DelayManifold
from chachart.node.estimation.periodogram import Periodogram, Power
from chachart.node.estimation.products import row_products

Floats = NDArray[np.float64]
Index = NDArray[np.intp]

DELAY_SPREAD_M = 30.0
"""Least t_0."""
ANGLE_SPREAD = 0.035
"""Least c_0, 2 degrees at broadside."""
FALSE_ALARM_DEVIATE = 3.719
"""Standard normal deviate of the share of noise-only points above the level, 1e-4."""
LEAST_PEAK = 0.01
"""Nor is a direct path so much weaker than the strongest one looked for."""
SIDE_LOBE_MARGIN = 3.0
"""A peak below so many times the strongest one's side lobes there is taken for one of them."""
CROWDING = 30.0
"""Echoes crowd around the direct path: their power shifts its peak so many times as much as spread evenly."""
SPREAD_DOUBT = 0.8
"""Squint and curvature explain away no more than the rest of the noise: simulated waves may have neither."""
LOBE_FINENESS = 4
"""Points per grid step between which the side lobes of elements with gaps are looked for."""
LEAST_NOISE = 1e-7
"""Of the whole power: what single precision adds."""
FLOOR_POINTS = 256
"""About so many of the spectrum's points tell its noise."""


class DirectPath:
    """Finds the direct path in spectra of one array.

    Parameters
    ----------
    array
        N_R x N_S, spacing, band.
    rho_max_m
        Farthest range that is searched.
    echoes
        Whether deviations allow for echoes that cannot be told from the path.
    """

    def __init__(self, array: ArrayGeometry, rho_max_m: float, echoes: bool = True) -> None:
        self._judge = judge("joint", 3) if echoes else alone
        self.angle, self.delay = AngleManifold.of(array), DelayManifold.of(array, rho_max_m)
        lattices = antennas, tones = self.angle.lattice, self.delay.lattice
        self.periodogram = Periodogram(antennas, tones)
        self._elements = antennas.size * tones.size
        a, d = self.periodogram.grid
        self._u, self._v = 2 * np.pi / a * np.arange(a), 2 * np.pi / d * np.arange(d)
        lag = np.arange(d)[:, None] - np.arange(d)  # [of the other path, of the candidate]
        cell_m = array.unambiguous_rho_m / tones.span
        cost = lag % d * (array.unambiguous_rho_m / d / max(DELAY_SPREAD_M, cell_m))
        self._delay_cost = cost.astype(np.float32)
        turn = _wrapped(self._u[:, None] - self._u)
        cell = 2 * np.pi / antennas.span / self.angle.phase
        cost = np.abs(turn) / self.angle.phase / max(ANGLE_SPREAD, cell / 2)
        self._angle_cost = cost.astype(np.float32)
        self._lobes = lobes(antennas, a), lobes(tones, d)
        cells = np.arange(a * d).reshape(a, d)
        ahead = [(0, -1), (-1, 0), (-1, -1), (-1, 1)]  # in memory; behind are the others
        ring = ahead + [(-i, -j) for i, j in ahead]
        self._neighbours = np.stack([np.roll(cells, shift, axis=(0, 1)).ravel() for shift in ring])
        cross = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
        self._cross = np.stack([np.roll(cells, shift, axis=(0, 1)).ravel() for shift in cross])
        self._allowed = self._searched()
        self._cells = [
            2 * np.pi / antennas.span / self.angle.phase,
            2 * np.pi / tones.span / abs(self.delay.phase),
        ]
        self._variance = [lattice.moment / lattice.size for lattice in lattices]
        step_hz, step_m = self._steps(array)
        self._squint = step_hz / array.middle_hz * np.sqrt(self._variance[0] * self._variance[1])
        self._bend = np.pi * step_m**2 / array.wavelength_m * float(np.std(antennas.centred**2))
        self._reach_m = antennas.span * step_m
        stride = max(int(np.sqrt(a * d / FLOOR_POINTS)), 1)
        self._sparse = slice(None, None, stride)
        points = len(range(0, a, stride)) * len(range(0, d, stride))
        self._doubt = 2 * 1.25 / np.sqrt(points)  # two standard deviations of a median of exponentials

    def find(self, power: Power, looks: Floats) -> Columns:
        """The direct paths in spectra (U, A, D) that average `looks` (U,) of one noise level.

        Beside theta, rho and their deviations there are, per element of a look, `power` of the path, `noise`
        with all other paths, and `floor`, the noise alone.
        """
        floor = self._floor(power, looks)
        peaks = self._peaks(power, looks, floor)
        cell, evidence = self._select(power, peaks, floor)
        u, v = self._parabola(power, cell)
        u, v, top, u_var, v_var = self._newton(power, u, v)
        lone = [1 / (2 * variance * top) for variance in self._variance]
        n = self._elements
        total = power.mean(axis=(1, 2), dtype=np.float64)
        least = LEAST_NOISE * total / n
        rest = np.maximum((total - top / n) / (n - 1), least)
        noise = np.clip(floor / n, least, rest)
        rest = np.maximum(rest - self._spread(u, v) * top / n**2, SPREAD_DOUBT * noise)
        noise = np.minimum(noise, rest)
        path = np.maximum(top / n - noise, 1e-3 * noise)
        # noise averages over the looks; other paths do not
        echoes = np.maximum(rest - (1 + self._doubt / np.sqrt(looks)) * noise, 0)
        error = n * (noise / looks * (1 + noise / path) + CROWDING * echoes)
        u_std, v_std = np.sqrt(error * u_var), np.sqrt(error * v_var)
        seen = [
            *(
                std * (span / (2 * np.pi))
                for std, span in zip((u_std, v_std), self.periodogram.span, strict=True)
            ),
            *(var / one for var, one in zip((u_var, v_var), lone, strict=True)),
            echoes / path * n,
            noise / path,
            self.delay.coordinate(-self._within(v, v_std)) / self._cells[1],
        ]
        evidence += [
            *log(np.stack(seen)),
            *(np.full(len(u), np.log(cell)) for cell in self._cells),
        ]
        stacked = np.stack(evidence, axis=1)
        growth_u, growth_v, odds = self._judge(stacked).T
        u = np.clip(_wrapped(u), self.angle.low, self.angle.high)
        v = -self._within(v, v_std)
        told = [
            np.minimum(inflated(std, growth), np.maximum((axis.high - axis.low) / np.sqrt(12), std))
            for std, growth, axis in ((u_std, growth_u, self.angle), (v_std, growth_v, self.delay))
        ]
        return {
            "theta": self.angle.coordinate(u),
            "rho": self.delay.coordinate(v),
            "theta_std": self.angle.coordinate_std(u, told[0]),
            "rho_std": self.delay.coordinate_std(v, told[1]),
            "theta_noise_std": self.angle.coordinate_std(u, u_std),
            "rho_noise_std": self.delay.coordinate_std(v, v_std),
            "p_direct": probability(odds),
            "power": path / n,
            "noise": rest,
            "floor": noise,
            "joint_evidence": stacked,
        }

    def _steps(self, array: ArrayGeometry) -> tuple[float, float]:
        """One step between tones in Hz, and one between elements in metres."""
        tones = self.delay.phase / array.rho_phase
        elements = self.angle.phase / array.theta_phase * array.carrier_hz / array.middle_hz
        return tones * array.subcarrier_spacing_hz, elements * array.element_spacing_m

    def _searched(self) -> NDArray[np.bool_]:
        """Grid points (A, D) where a direct path may have its maximum: up to one step out of range."""
        a, d = self.periodogram.grid
        angle = np.abs(_wrapped(self._u)) <= self.angle.high + 2 * np.pi / a
        step = 2 * np.pi / d
        delay = (self._v <= -self.delay.low + step) | (self._v >= 2 * np.pi - 1.5 * step)
        searched: NDArray[np.bool_] = angle[:, None] & delay
        return searched

    def _spread(self, u: Floats, v: Floats) -> Floats:
        """Share (U,) of a path's power beside its peak, for being no plane wave of a single frequency.

        Squint turns element m of subcarrier n by u m n spacing / carrier, curvature by
        pi (d m sin(theta))^2 / (wavelength rho), with m and n counted from the middle: the share is these
        phases' variance. They are symmetric and hardly shift the peak.
        """
        u, v = _wrapped(u), v % (2 * np.pi)
        sine2 = np.maximum(1 - (u / self.angle.phase) ** 2, 0)
        bend = self._bend * sine2 / np.maximum(self.delay.coordinate(v), self._reach_m)
        spread: Floats = (u * self._squint) ** 2 + bend**2
        return spread

    def _floor(self, power: Power, looks: Floats) -> Floats:
        """Noise level (U,), from the median of some points: most of the plane holds no path."""
        some = power[:, self._sparse, self._sparse].reshape(len(power), -1)
        middle = some.shape[1] // 2
        median: Floats = np.partition(some, middle, axis=1)[:, middle].astype(np.float64)
        return median / gamma_quantile(looks, 0.0)

    def _peaks(self, power: Power, looks: Floats, floor: Floats) -> Index:
        """Flat indices, ascending, of maxima that noise would rarely reach; for each UE at least one."""
        k, cells = len(power), self._neighbours.shape[1]
        flat = power.reshape(-1)
        level = np.maximum(
            floor * gamma_quantile(looks, FALSE_ALARM_DEVIATE),
            LEAST_PEAK * power.reshape(k, cells).max(axis=1),
        )
        above = power >= level.astype(np.float32)[:, None, None]
        above &= self._allowed
        peaks = np.flatnonzero(above)
        cell = peaks % cells
        around, height = flat[(peaks - cell) + self._neighbours[:, cell]], flat[peaks]
        # of equal ones that lie together, one is left
        peaks = peaks[(height > around[:4]).all(axis=0) & (height >= around[4:]).all(axis=0)]
        found = np.bincount(peaks // cells, minlength=k)
        lost = np.flatnonzero(found == 0)
        if len(lost):
            best = np.where(self._allowed, power[lost], 0).reshape(len(lost), cells).argmax(axis=1)
            peaks = np.sort(np.concatenate([peaks, lost * cells + best]))
        return peaks

    def _select(self, power: Power, peaks: Index, floor: Floats) -> tuple[Index, list[Floats]]:
        """The direct path's grid point (U,), flat within its spectrum, among the peaks of all spectra.

        And columns (U,) of what tells how sure that is.
        """
        a, d = self.periodogram.grid
        k = len(power)
        ue, cell = np.divmod(peaks, a * d)
        i, j = np.divmod(cell, d)
        height = power.reshape(-1)[peaks]
        first = np.searchsorted(ue, np.arange(k))
        highest = np.maximum.reduceat(height, first)[ue]
        strongest = of_each(ue, height == highest, k)[ue]
        lobe = self._lobes[0][(i - i[strongest]) % a] * self._lobes[1][(j - j[strongest]) % d]
        net = np.maximum(height - floor.astype(np.float32)[ue], np.float32(1e-3) * height)
        net[height < np.minimum(SIDE_LOBE_MARGIN * lobe, 1) * highest] = 0
        share = net / np.add.reduceat(net, first)[ue]
        delays = np.bincount(ue * d + j, share, k * d).reshape(k, d).astype(np.float32)
        angles = np.bincount(ue * a + i, share, k * a).reshape(k, a).astype(np.float32)
        score = np.log(np.maximum(share, np.float32(1e-30)))
        excess = row_products(delays, self._delay_cost)[ue, j]
        beside = row_products(angles, self._angle_cost)[ue, i]
        score -= excess
        score -= beside
        candidates = Candidates(ue, i, j, share, excess, beside, score)
        chosen = candidates.best(k)
        return cell[chosen], candidates.evidence(chosen, self.periodogram.grid, self.periodogram.span)

    def _parabola(self, power: Power, cell: Index) -> tuple[Floats, Floats]:
        """u and v (U,) of the vertices of parabolas through the logarithms around grid points `cell` (U,)."""
        a, d = self.periodogram.grid
        start = np.arange(len(power)) * self._cross.shape[1]
        height = np.maximum(power.reshape(-1)[start + self._cross[:, cell]], np.finfo(np.float32).tiny)
        here, before_u, after_u, before_v, after_v = np.log(height)
        i, j = np.divmod(cell, d)
        u = (i + _vertex(before_u, here, after_u)) * (2 * np.pi / a)
        v = (j + _vertex(before_v, here, after_v)) * (2 * np.pi / d)
        return u, v

    def _newton(self, power: Power, u: Floats, v: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """One step on P: u, v, the height there, and the diagonal of minus the inverse Hessian, each (U,).

        Where P is not concave the point stays, and the curvature is taken to be a lone path's.
        """
        f = self.periodogram.derivatives(power, u, v)
        top, fu, fv = f[:, 0, 0], f[:, 1, 0], f[:, 0, 1]
        fuu, fvv, fuv = f[:, 2, 0], f[:, 0, 2], f[:, 1, 1]
        det = fuu * fvv - fuv * fuv
        concave = (fuu < 0) & (fvv < 0) & (det > 0)
        det[~concave] = 1
        limits = [np.pi / span for span in self.periodogram.span]
        du = np.where(concave, np.clip((fuv * fv - fvv * fu) / det, -limits[0], limits[0]), 0)
        dv = np.where(concave, np.clip((fuv * fu - fuu * fv) / det, -limits[1], limits[1]), 0)
        top = np.maximum(top + (fu * du + fv * dv) / 2, 1e-30)
        lone = [1 / (2 * variance * top) for variance in self._variance]
        u_var = np.where(concave, -fvv / det, lone[0])
        v_var = np.where(concave, -fuu / det, lone[1])
        return u + du, v + dv, top, u_var, v_var

    def _within(self, v: Floats, v_std: Floats) -> Floats:
        """v in the searched range; a little below 0, it is noise about 0 rather than the circle's far end."""
        v = v % (2 * np.pi)
        far = -self.delay.low
        slack = np.minimum(3 * v_std, np.pi / self.delay.lattice.span)
        zero = 2 * np.pi - v < np.maximum(slack, v - far)
        return np.where(zero, 0, np.minimum(v, far))


def _wrapped(angle: NDArray[Any]) -> NDArray[Any]:
    """The same angle in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def lobes(lattice: Lattice, grid: int) -> Power:
    """Envelope of a path's main and side lobes in P at the grid's points from its own, 1 at the top."""
    x = np.arange(grid) / grid
    lobes = 1 / np.maximum((lattice.span * np.sin(np.pi * x)) ** 2, 1)
    if not lattice.dense:  # gaps lift some of them: the largest within a step either way
        row = lattice.spread_out(np.ones(lattice.size), 0)
        pattern = np.abs(np.fft.fft(row, LOBE_FINENESS * grid) / lattice.size) ** 2
        near = np.roll(pattern, LOBE_FINENESS).reshape(-1)
        width = 2 * LOBE_FINENESS + 1
        windows = np.lib.stride_tricks.sliding_window_view(np.r_[near, near[:width]], width)
        lobes = np.maximum(lobes, windows[::LOBE_FINENESS][:grid].max(axis=1))
    return np.asarray(lobes, np.float32)


def gamma_quantile(n: Floats, deviate: float) -> Floats:
    """Quantile of the mean of n exponentials of mean 1, n >= 1, to 5 % (Wilson and Hilferty 1931)."""
    return (1 - 1 / (9 * n) + deviate / (3 * np.sqrt(n))) ** 3


def of_each(ue: Index, chosen: NDArray[np.bool_], count: int) -> Index:
    """Index (count,) of a chosen entry of each UE."""
    of = np.empty(count, np.intp)
    at = np.flatnonzero(chosen)
    of[ue[at]] = at
    return of


def _vertex(left: Power, middle: Power, right: Power) -> Floats:
    """Where the parabola through three neighbours peaks, in steps from the middle one."""
    curvature = np.minimum(left - 2 * middle + right, np.float32(-1e-6))
    vertex: Floats = np.clip((left - right) / curvature / 2, -0.5, 0.5).astype(np.float64)
    return vertex
