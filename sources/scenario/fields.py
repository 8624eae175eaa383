"""Correlated Gaussian fields over the plane, for large-scale parameters that follow a UE.

A field is a sum of plane cosine waves, so it is defined everywhere, smooth, and costs the same however large
the area. The wave numbers are drawn from the spectrum of the autocorrelation that QuaDRiGa uses,
r(d) = exp(-(d/s)^2) up to d = s and exp(-d/s) beyond: flat at the origin, exponential far away.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

Floats = NDArray[np.float64]

WAVES = 300
"""Cosines in a field: enough for its values to be Gaussian."""


def autocorrelation(distance: NDArray[Any]) -> Floats:
    """r(d) for distances in units of the decorrelation distance."""
    d = np.asarray(distance, np.float64)
    return np.where(d < 1, np.exp(-(d**2)), np.exp(-d))


class GaussianFields:
    """Independent fields of mean 0 and variance 1, one for each decorrelation distance.

    Parameters
    ----------
    decorrelation_m
        (F,) distances s of the autocorrelation.
    rng
        Draws wave numbers, directions and phases.
    """

    def __init__(self, decorrelation_m: NDArray[Any], rng: np.random.Generator) -> None:
        fields = len(decorrelation_m)
        quantile, radial = _spectrum()
        strata = (np.arange(WAVES) + rng.random((fields, WAVES))) / WAVES
        wave_number = np.interp(strata, quantile, radial) / np.asarray(decorrelation_m)[:, None]
        direction = rng.uniform(0, 2 * np.pi, (fields, WAVES))
        self._waves = wave_number / (2 * np.pi) * np.stack([np.cos(direction), np.sin(direction)])
        self._phase = rng.random((fields, WAVES))

    def at(self, position: NDArray[Any]) -> Floats:
        """Values (K, F) at world positions (K, 3) or (K, 2); height does not matter."""
        columns = []
        for kx, ky, phase in zip(*self._waves, self._phase, strict=True):
            cycles = position[:, :1] * kx + position[:, 1:2] * ky + phase
            cycles -= np.rint(cycles)
            columns.append(np.cos((2 * np.pi * cycles).astype(np.float32)).sum(axis=1))
        values: Floats = np.sqrt(2 / WAVES) * np.stack(columns, axis=1, dtype=np.float64)
        return values


@cache
def _spectrum() -> tuple[Floats, Floats]:
    """Quantiles of the radial wave number: the Hankel transform of the autocorrelation, as a distribution.

    The kink at d = s makes the transform slightly negative in places; there it counts as zero.
    """
    d = np.linspace(0, 25, 5000)
    k = np.linspace(0, 8, 200)
    density = k * (j0(k[:, None] * d) @ (autocorrelation(d) * d))
    cumulative = np.cumsum(np.maximum(density, 0.0))
    cumulative -= cumulative[0]
    return cumulative / cumulative[-1], k
