"""Cramér-Rao bounds on the electrical angle u of a single path, and on theta and rho.

x_m = s_m a(u) + noise, m = 1 ... M snapshots of N elements, signal power P and noise power sigma^2 per
element, SNR = P / sigma^2. Two bounds matter (Stoica and Nehorai 1989, 1990):

- deterministic: the s_m are unknown constants, var(u) >= 6 / (M SNR N (N^2 - 1));
- stochastic: the s_m are Gaussian of unknown power, larger by 1 + 1 / (N SNR). It is what an estimator that
only
  sees the sample covariance of many snapshots can reach, hence the one to hold the estimators here against.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry

Floats = NDArray[np.float64]


def deterministic_std(size: int, snapshots: Any, snr: Any) -> Floats:
    """Bound on the standard deviation of u (rad); `snr` is linear, per element."""
    m, ratio = np.asarray(snapshots, np.float64), np.asarray(snr, np.float64)
    return np.sqrt(6 / (m * ratio * size * (size**2 - 1)))


def stochastic_std(size: int, snapshots: Any, snr: Any) -> Floats:
    """Bound on the standard deviation of u (rad); `snr` is linear, per element."""
    ratio = np.asarray(snr, np.float64)
    variance = 6 / (snapshots * ratio * (size * (size**2 - 1))) * (1 + 1 / (size * ratio))
    std: Floats = np.sqrt(variance)
    return std


def mvdr_excess(size: int, snapshots: Any, snr: Any, loading: float) -> Floats:
    """How many times the stochastic bound the variance of loaded MVDR is, because R's inverse is noisy too.

    Perturbation of the spectrum's minimum to first order in the cross terms between path and noise, with the
    noise block's inverse averaged by the Marchenko-Pastur law: m_1 and m_2 are the mean first and second
    powers of (C + delta I)^-1 for a white sample covariance C of ratio y = (N - 1) / M. Unloaded, at high
    SNR, this is 1 / (1 - y).
    """
    m, ratio = np.asarray(snapshots, np.float64), np.asarray(snr, np.float64)
    y, delta = (size - 1) / m, np.maximum(loading * (ratio + 1), 1e-9)
    b = 1 - y + delta
    root = np.sqrt(b * b + 4 * y * delta)
    m1 = 2 / (root + b)
    weight = m1 - delta * (y * m1 + 1) * m1 / root
    beam = size * ratio + 1
    schur = beam * (1 - y * (1 - delta * m1)) + delta
    excess: Floats = weight * ((beam - 1) / (schur * m1 - 1 + beam * weight / m)) ** 2
    return excess


def theta_std(array: ArrayGeometry, theta: Any, snr: Any, frames: Any, *, stochastic: bool = True) -> Floats:
    """Bound on theta (rad) at true `theta`, each of `frames` frames giving a snapshot per subcarrier."""
    bound = stochastic_std if stochastic else deterministic_std
    u = bound(array.antennas, np.asarray(frames) * array.subcarriers, snr)
    std: Floats = u / (array.theta_phase * np.sin(theta))
    return std


def rho_std(array: ArrayGeometry, snr: Any, frames: Any, *, stochastic: bool = True) -> Floats:
    """Bound on rho (m), each of `frames` frames giving a snapshot per antenna."""
    bound = stochastic_std if stochastic else deterministic_std
    return bound(array.subcarriers, np.asarray(frames) * array.antennas, snr) / abs(array.rho_phase)
