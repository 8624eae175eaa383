"""Soft fusion: the position that explains what all arrays have received, looked for in their spectra.

Fusing peaks commits every array to one direction and delay before it has heard the others; an echo that is
the strongest path of one array then spoils the position. Here each array's angle-delay spectrum says how well
it knows any position (direct position determination, Weiss, IEEE SPL 11(5), 2004), and what is summed over
arrays is bounded, so that an array that does not hear the direct wave cannot do much harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from chachart.node.estimation.fusion.agreement import broad, fit, weights
from chachart.node.estimation.fusion.area import Area
from chachart.node.estimation.fusion.certainty import Fused, judged
from chachart.node.estimation.fusion.climb import Climb
from chachart.node.estimation.fusion.received import Received
from chachart.node.estimation.fusion.site import Complex, Floats, Site

Clock = Literal["shared", "offset", "own"]
Singles = NDArray[np.float32]

CHUNK = 32
"""UEs at once: fewer cost more calls, more only memory."""
MODES = 5
"""Maxima of the coarse search that are followed up."""


class Fuser:
    """Locates UEs from one frame of each array.

    Parameters
    ----------
    sites
        The arrays.
    area
        Where UEs can be.
    clock
        `shared`: delays are absolute. `offset`: all arrays share a clock that the UE does not; what it adds
        to all delays of a frame is estimated with the position. `own`: no two clocks are related, so that
        only directions count.

    Raises
    ------
    ValueError
        If there is no array, or the area has no point.
    """

    def __init__(self, sites: Sequence[Site], area: Area, clock: Clock = "shared") -> None:
        if not sites:
            raise ValueError("fusion needs at least one array")
        self.sites, self.area, self.clock = tuple(sites), area, clock
        self._grid = area.grid(self.sites)
        if not self._grid.inside.any():
            raise ValueError("the area that UEs can be in is empty")
        self._looks = [_Look(site, self._grid.points) for site in self.sites]
        self._basis = area.basis
        self._spread = np.cov(self._grid.points[self._grid.inside].T)
        self._climb = Climb(self._basis, self._grid.step, clock == "offset")

    def locate(self, frames: Sequence[Complex], near: Floats | None = None) -> Fused:
        """Positions of U UEs.

        Parameters
        ----------
        frames
            One complex64 (U, N, S) an array, in the order of `sites`; zeros where it has not heard a UE.
        near
            Positions (U, K, 3) to search from besides the best of the coarse grid; NaN where there is none.
        """
        users = len(frames[0])
        found = []
        for i in range(0, users, CHUNK):
            part = slice(i, i + CHUNK)
            found.append(self._locate([f[part] for f in frames], None if near is None else near[part]))
        return Fused.concatenate(found)

    def _locate(self, frames: list[Complex], near: Floats | None) -> Fused:
        heard = [Received(site, csi) for site, csi in zip(self.sites, frames, strict=True)]
        view = _View(heard, self._looks, self.clock)
        score, offset = view.coarse()
        score[:, ~self._grid.inside] = -np.inf
        start, delay = self._modes(score, offset)
        if near is not None:
            start = np.concatenate([start, np.where(np.isnan(near), start[:, :1], near)], axis=1)
            if delay is not None:
                delay = np.concatenate([delay, np.repeat(delay[:, :1], near.shape[1], axis=1)], axis=1)
        peaks = self._climb(view, start, delay)
        return judged(view, peaks, self._basis, self._spread)

    def _modes(self, score: Singles, offset: Singles | None) -> tuple[Floats, Floats | None]:
        """The highest local maxima of the coarse scores (U, G): points (U, M, 3), and their offsets."""
        shape = (len(score), *self._grid.shape)
        size = (1, *(3 for _ in self._grid.shape))
        peak = maximum_filter(score.reshape(shape), size=size, mode="nearest").reshape(score.shape)
        tops = np.where(score >= peak, score, -np.inf)
        count = min(MODES, tops.shape[1])
        best = np.argpartition(-tops, count - 1, axis=1)[:, :count]
        there = np.take_along_axis(tops, best, axis=1)
        best = np.where(np.isfinite(there), best, score.argmax(axis=1)[:, None])
        points = self._grid.points[best]
        if offset is None:
            return points, None
        return points, np.take_along_axis(offset, best, axis=1).astype(np.float64)


class _Look:
    """Where each coarse point is looked up in an array's spectrum."""

    def __init__(self, site: Site, points: Floats) -> None:
        self.beams, self.which = site.beams(points)
        self.rho, self.front = site.ranges(points)


class _View:
    """What all arrays say about positions of the UEs of one chunk.

    Attributes
    ----------
    weight
        Of each array (U, B).
    most
        Largest share of the array's energy that one direction and delay explain, (U, B).
    """

    def __init__(self, heard: list[Received], looks: list[_Look], clock: Clock) -> None:
        self._heard, self._looks, self._clock = heard, looks, clock
        self._spectra = [r.spectrum(look.beams) for r, look in zip(heard, looks, strict=True)]
        self.energy = np.stack([r.energy for r in heard], axis=1)
        peak = np.stack([s.max(axis=(1, 2)) for s in self._spectra], axis=1)
        some: Singles = np.maximum(self.energy, np.float32(1e-30))
        self.most = np.maximum(peak / some, np.float32(1e-6))
        rho: Floats | None = None
        if clock == "shared":
            at = [s.max(axis=1).argmax(axis=1) for s in self._spectra]
            rho = np.stack(at, axis=1) * np.array([self._step(i) for i in range(len(at))])
        self.weight: Singles = weights(peak, rho, clock) * (self.energy > 0).astype(np.float32)
        self._scale: Singles = np.reciprocal(some)

    def _step(self, i: int) -> float:
        delays: int = self._spectra[i].shape[2]
        return self._heard[i].site.unambiguous_m / delays

    def coarse(self) -> tuple[Singles, Singles | None]:
        """Scores (U, G) of the coarse points, and the offset (U, G) in metres that each is best with."""
        if self._clock == "offset":
            return self._coarse_with_offset()
        total = np.zeros((len(self.energy), len(self._looks[0].which)), np.float32)
        for i, (look, table) in enumerate(zip(self._looks, self._tables(), strict=True)):
            if self._clock == "own":
                said = table.max(axis=2)[:, look.which]
            else:
                said = self._looked_up(i, table, look.rho)
            total += np.where(look.front, said, self._unheard(i))
        return total, None

    def _coarse_with_offset(self) -> tuple[Singles, Singles]:
        """As `coarse`; tried are offsets that make some array's strongest delay in that direction direct."""
        tables = self._tables()
        best = np.full((len(self.energy), len(self._looks[0].which)), -np.inf, np.float32)
        offset = np.zeros_like(best)
        for i, look in enumerate(self._looks):
            strongest = (tables[i].argmax(axis=2) * np.float32(self._step(i))).astype(np.float32)
            tried = strongest[:, look.which] - look.rho.astype(np.float32)
            total = np.zeros_like(best)
            for j, (other, table) in enumerate(zip(self._looks, tables, strict=True)):
                said = self._looked_up(j, table, other.rho.astype(np.float32) + tried)
                total += np.where(other.front, said, self._unheard(j))
            better = total > best
            best[better], offset[better] = total[better], tried[better]
        return best, offset

    def _tables(self) -> list[Singles]:
        """Weighted log likelihoods of all directions and delays, (U, D, L) an array."""
        return [
            self.weight[:, i, None, None]
            * broad(s * self._scale[:, i, None, None], self.most[:, i, None, None])
            for i, s in enumerate(self._spectra)
        ]

    def _looked_up(self, i: int, table: Singles, far: NDArray[np.floating]) -> Singles:
        """Entries (U, G) at the points' directions and at distances (G,) or (U, G)."""
        delays = table.shape[2]
        index = np.rint(far / self._step(i)).astype(np.int32) % delays
        index += (self._looks[i].which * delays).astype(np.int32)
        flat = table.reshape(len(table), -1)
        return flat[:, index] if index.ndim == 1 else np.take_along_axis(flat, index, axis=1)

    def _unheard(self, i: int) -> Singles:
        none = np.zeros((len(self.energy), 1), np.float32)
        said: Singles = self.weight[:, i, None] * broad(none, self.most[:, i, None])
        return said

    def shares(self, points: Floats, offset: Floats | None) -> Singles:
        """Shares (U, Q, B) of the arrays' energy that waves from `points` (U, Q, 3) explain."""
        found = []
        for i, received in enumerate(self._heard):
            power = received.best_power(points) if self._clock == "own" else received.power(points, offset)
            found.append(power * self._scale[:, i, None])
        return np.stack(found, axis=2)

    def score(self, points: Floats, offset: Floats | None, sharp: bool) -> Singles:
        """Summed log likelihoods (U, Q)."""
        share = self.shares(points, offset)
        most = self.most[:, None, :]
        said = fit(share, most) if sharp else broad(share, most)
        total: Singles = np.einsum("uqb,ub->uq", said, self.weight)
        return total
