"""The noise's power in a covariance that also holds any number of paths: from the quiet half of its beams."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.circle import Circle
from chachart.node.estimation.lattice import Lattice

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

_LOWER_HALF = math.sqrt(2 / math.pi)
"""The mean of the lower half of a normal distribution lies so many standard deviations below its mean."""


class NoiseFloor:
    """Mean power of the lower half of N beams over the whole range of u, less what picking the lower half
    takes.

    The beams carry a Hann taper (applied to the lags, so that lag sums suffice), without which the side
    lobes of a strong path would pass for noise. Paths may take up to half of the beams.

    Parameters
    ----------
    lattice
        Of the N elements.
    """

    def __init__(self, lattice: Lattice) -> None:
        span, lags = lattice.span, lattice.lags
        taper = np.hanning(span + 2)[1:-1]
        full = np.correlate(taper, taper, "full")[span - 1 :] / np.vdot(taper, taper)
        kernel = np.where(lattice.pairs > 0, full[lags], 0)
        window = kernel * lattice.size / np.maximum(lattice.pairs, 1)
        self._beams = Circle(lags, span, np.arange(span), np.float32, window)
        both_sides = np.r_[1.0, np.full(len(lags) - 1, 2.0)]
        self._spread = math.sqrt(float(np.sum(both_sides * kernel * window)) / lattice.size)

    def power(self, lags: Complex, snapshots: Floats) -> Floats:
        """Noise power per element (U,).

        Parameters
        ----------
        lags
            (U, L) lag polynomials of covariances per element, lags[:, 0] being the mean power.
        snapshots
            (U,) number behind each.
        """
        beams = self._beams.values(lags)
        beams.sort(axis=1)
        quiet = beams[:, : beams.shape[1] // 2].mean(axis=1, dtype=np.float64)
        power: Floats = quiet / np.maximum(1 - _LOWER_HALF * self._spread / np.sqrt(snapshots), 0.1)
        return power
