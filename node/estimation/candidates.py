"""What candidates for the direct path tell of the choice among them: evidence for the judge of `joint`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.intp]

RIVALS: Final = 2
"""So many of the next best candidates are looked at one by one."""
FAR_BEHIND: Final = 8.0
"""Difference of log scores that counts as certain."""
NEAR: Final = 8.0
"""Resolution cells within which others count as near."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Candidates of all UEs, those of a UE together, (P,) each.

    Attributes
    ----------
    ue
        Which UE's, ascending.
    angle, delay
        Where on the grid.
    share
        Of the power of the UE's candidates.
    excess, beside
        The costs of being early among the rest, and aside from it.
    score
        Log share less these costs.
    """

    ue: Index
    angle: Index
    delay: Index
    share: NDArray[Any]
    excess: NDArray[Any]
    beside: NDArray[Any]
    score: NDArray[Any]

    def best(self, count: int) -> Index:
        """Index (U,) of each UE's candidate of the best score."""
        first = np.searchsorted(self.ue, np.arange(count))
        top = np.flatnonzero(self.score == np.maximum.reduceat(self.score, first)[self.ue])
        of = np.empty(count, np.intp)
        of[self.ue[top]] = top
        return of

    def evidence(self, chosen: Index, grid: tuple[int, int], span: tuple[int, int]) -> list[Floats]:
        """Columns (U,) of what tells how sure the choice of `chosen` (U,) is; distances are in cells.

        Parameters
        ----------
        grid, span
            Points on the circles of angle and delay, and resolution cells there.
        """
        ue, count = self.ue, len(chosen)
        first = np.searchsorted(ue, np.arange(count))
        belief = np.exp(self.score - self.score[chosen][ue])
        belief /= np.add.reduceat(belief, first)[ue]
        others = belief.copy()
        others[chosen] = 0
        off_angle = _turn(self.angle - self.angle[chosen][ue], grid[0]) * (span[0] / grid[0])
        off_delay = _turn(self.delay - self.delay[chosen][ue], grid[1]) * (span[1] / grid[1])
        near = np.abs(off_delay) <= NEAR
        weighted = [
            others,
            belief * off_delay**2,
            belief * off_angle**2,
            self.share * (near & (off_delay < 0)),
            self.share * (near & (off_delay > 0)),
            self.share * off_angle**2,
            np.ones(len(ue)),
        ]
        unsure, *spreads = np.add.reduceat(np.stack(weighted), first, axis=1)
        share = self.share[chosen]
        alone = [
            share,
            share / np.maximum.reduceat(self.share, first),
            self.excess[chosen],
            self.beside[chosen],
        ]
        columns = list(log(np.stack([unsure, *alone, *spreads])))
        left = self.score.astype(np.float64)
        best = chosen
        for _ in range(RIVALS):
            left[best] = -np.inf
            highest = np.maximum.reduceat(left, first)
            none = np.isneginf(highest)
            rival = np.flatnonzero((left == highest[ue]) & ~none[ue])
            best = chosen.copy()
            best[ue[rival]] = rival
            gap = np.where(none, FAR_BEHIND, np.minimum(self.score[chosen] - self.score[best], FAR_BEHIND))
            columns += [
                gap.astype(np.float64),
                log(np.where(none, 0, self.share[best])),
                np.arcsinh(off_delay[best]),
                np.arcsinh(np.abs(off_angle[best])),
            ]
        return columns


def log(value: NDArray[Any]) -> Floats:
    """Logarithm of what may be 0, or nearly."""
    logarithm: Floats = np.log(np.clip(value, 1e-5, 1e5).astype(np.float64))
    return logarithm


def _turn(steps: Index, around: int) -> Index:
    """Steps on a circle, the short way."""
    return (steps + around // 2) % around - around // 2
