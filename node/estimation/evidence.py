"""What a covariance's lags tell of an estimate read from them: is one wave all there is?

A lone wave in white noise has c_k proportional to exp(-j k u). Echoes that are not resolved make the lags
fall off and turn, those that are show as beams of their own. All of it is relative to the estimate and in
resolution cells, so that it means the same for any array and band.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.circle import Circle
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.noise import NoiseFloor

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

LAGS: Final = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4)
"""Lags whose coherence is looked at, as shares of the longest."""
NEAR: Final = 4.0
"""Cells around the estimate in which echoes count as near."""
LOBE: Final = 1.0
"""Cells from the estimate within which its own main lobe is."""
LEAST: Final = 1e-4
"""Shares of power below which nothing is told apart ..."""
MOST: Final = 10.0
"""... and above which."""


class AxisEvidence:
    """Evidence on one axis.

    Parameters
    ----------
    lattice
        Of its elements.
    cell
        How much of the coordinate a resolution cell is: metres, or the cosine of theta.
    """

    NAMES: Final = (
        "noise",
        "snr",
        "unexplained",
        *(f"loss{n}" for n in range(len(LAGS))),
        *(f"turn{n}" for n in range(len(LAGS))),
        "near",
        "highest",
        "cell",
    )

    def __init__(self, lattice: Lattice, cell: float) -> None:
        self._lattice, self._cell = lattice, cell
        self._floor = NoiseFloor(lattice)
        wanted = np.unique([np.abs(lattice.lags - share * lattice.lags[-1]).argmin() for share in LAGS])
        self._picked = np.resize(wanted[wanted > 0], len(LAGS))
        self._scale = lattice.size / (2 * np.maximum(lattice.pairs, 1))
        count = 2 * lattice.span
        offsets = np.arange(count) - count // 2
        offsets = offsets[np.abs(offsets) / 2 > LOBE]
        offsets = offsets[np.argsort(np.abs(offsets), kind="stable")]
        self._near = int(np.count_nonzero(np.abs(offsets) / 2 <= NEAR))
        self._around = Circle(lattice.lags, count, offsets, np.float32)

    def of(self, lags: Complex, turned: Complex, u_std: Floats, snapshots: Floats) -> Floats:
        """Evidence (U, F) on estimates.

        Parameters
        ----------
        lags
            (U, L) of covariances per element, lags[:, 0] being the mean power.
        turned
            (U, L) their terms at the estimate, c_k exp(j k u).
        u_std
            (U,) deviation of the estimate if noise were all.
        snapshots
            (U,) behind each covariance.
        """
        n, shares = self._lattice.size, len(LAGS)
        total = lags[:, 0].real
        noise = np.minimum(self._floor.power(lags, snapshots), total)
        noise = np.maximum(noise, LEAST * LEAST * total)
        signal = np.maximum(total - noise, total / np.sqrt(n * snapshots))
        coherence = turned[:, self._picked] * (self._scale[self._picked] / signal[:, None])
        beams = self._around.values(turned)
        # the path's own is not one of these beams, whose rounding may be all that is left
        path = (turned.real.sum(axis=1) - noise) / (n * signal)
        near = np.maximum(beams[:, : self._near] - noise[:, None].astype(np.float32), 0).sum(axis=1) / 2
        highest = beams.max(axis=1) - noise if beams.shape[1] else np.zeros(len(lags))
        found = np.empty((len(self.NAMES), len(lags)))
        found[0] = u_std * (self._lattice.span / (2 * np.pi))
        found[1] = signal / noise
        found[2] = 1 - path
        found[3 : 3 + shares] = 1 - coherence.real.T
        np.abs(coherence.imag.T, out=found[3 + shares : 3 + 2 * shares])
        found[-3] = near / (n * signal)
        found[-2] = highest / (n * signal)
        found[-1] = self._cell
        np.clip(found[2:-1], LEAST, MOST, out=found[2:-1])
        evidence: Floats = np.log(found, out=found).T
        return evidence
