"""Steps and matrices of two coordinates, for many UEs at once; symmetric matrices are (3, K: 11, 12, 22)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def packed(m: Floats) -> Floats:
    """(3, K: 11, 12, 22) of symmetric matrices (K, 2, 2)."""
    return np.stack([m[:, 0, 0], m[:, 0, 1], m[:, 1, 1]])


def newton_step(slope: Floats, bend: Floats, limit: float) -> Floats:
    """The step (2, K) to a minimum; downhill where the curvature (3, K) is not positive; at most `limit`."""
    a, b, c = bend
    det = a * c - b * b
    sound = (a > 0) & (det > 0)
    det = np.where(sound, det, 1)
    newton = np.stack([(b * slope[1] - c * slope[0]) / det, (b * slope[0] - a * slope[1]) / det])
    size = np.hypot(*slope)
    downhill = -slope * (limit / np.maximum(size, 1e-300))
    step = np.where(sound, newton, downhill)
    shrink = np.minimum(limit / np.maximum(np.hypot(*step), 1e-300), 1)
    shrunk: Floats = step * shrink
    return shrunk


def inverse(m: Floats) -> Floats:
    """Of symmetric 2 x 2 matrices (3, K: 11, 12, 22)."""
    a, b, c = m
    det = np.maximum(a * c - b * b, 1e-300)
    inverted: Floats = np.stack([c, -b, a]) / det
    return inverted


def congruent(c: Floats, m: Floats) -> Floats:
    """C M C of symmetric 2 x 2 matrices (3, K: 11, 12, 22)."""
    (c0, c1, c2), (m0, m1, m2) = c, m
    x0, x1 = m0 * c0 + m1 * c1, m0 * c1 + m1 * c2
    y0, y1 = m1 * c0 + m2 * c1, m1 * c1 + m2 * c2
    return np.stack([c0 * x0 + c1 * y0, c0 * x1 + c1 * y1, c1 * x1 + c2 * y1])
