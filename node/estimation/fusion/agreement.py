"""What an array says about a position: two log likelihoods that no single array can spoil.

With p the share of the array's energy that a wave from the position explains, P/E, and m the largest share
that any direction and delay explain, the likelihood of a wave in noise of unknown level, which the other
paths of the channel are, is (1 - p)^-k. A direct wave that the array does not hear leaves p anywhere; mixed
with that,

    fit = log(((1 - m) / (1 - p))^k + e),        broad = log(p / m + e'),

`fit` is sharp where one path stands out and flat where many share the energy, and nothing pulls far from
the peak. `broad` is log P of Bartlett's spectrum: its slopes reach further, so that searches begin with it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]

SHARPNESS = 4.0
"""k: independent looks that the other paths of a channel are worth."""
UNHEARD = 0.3
"""e: the weight of not hearing the direct wave."""
UNHEARD_BROAD = 0.2
"""e' of `broad`."""
_PURE = 1e-3
"""Share of energy that stays unexplained, however good the fit: elements are never alike."""
HALF_WEIGHT_DB = {"shared": 20.0, "offset": 10.0, "own": 10.0}
"""Excess loss at which an array counts half; less where the distance is not known and part of the loss."""


def fit(share: Singles, most: Singles) -> Singles:
    """The sharp log likelihood of shares p where the array's largest is `most`, like shapes."""
    whole = np.float32(1 + _PURE)
    ratio: Singles = (whole - most) / (whole - share)
    ratio *= ratio
    ratio *= ratio
    ratio += np.float32(UNHEARD)
    said: Singles = np.log(ratio)
    return said


def broad(share: Singles, most: Singles) -> Singles:
    """The wide log likelihood of shares p where the array's largest is `most`, like shapes."""
    said: Singles = np.log(share / most + np.float32(UNHEARD_BROAD))
    return said


def weights(peak: Singles, rho_m: NDArray[np.float64] | None, clock: str) -> Singles:
    """Weights (U, B) of arrays by excess loss: 1 / (1 + (Delta / half)^4).

    Delta is by how many dB `peak` (U, B), the power of the strongest path, times the square of its range
    `rho_m` is below that of the UE's best array. An array without a peak weighs nothing.
    """
    power = peak.astype(np.float64)
    if rho_m is not None:
        power *= np.maximum(rho_m, 1.0) ** 2
    best = power.max(axis=1, keepdims=True)
    with np.errstate(divide="ignore"):
        loss = 10 * np.log10(np.maximum(best, 1e-300) / power)
    found: Singles = (1 / (1 + (loss / HALF_WEIGHT_DB[clock]) ** 4)).astype(np.float32)
    return found
