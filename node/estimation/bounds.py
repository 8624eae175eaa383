"""Cramér-Rao bounds on the electrical angle u of a single path, and on theta and rho.

x_m = s_m a(u) + noise, m = 1 ... M snapshots of N elements at places p_n, signal power P and noise power
sigma^2 per element, SNR = P / sigma^2, V = sum of (p_n - mean p)^2, N (N^2 - 1) / 12 for an even row. Two
bounds matter (Stoica and Nehorai 1989, 1990):

- deterministic: the s_m are unknown constants, var(u) >= 1 / (2 M SNR V);
- stochastic: the s_m are Gaussian of unknown power, larger by 1 + 1 / (N SNR). It is what an estimator that
only
  sees the sample covariance of many snapshots can reach, hence the one to hold the estimators here against.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.lattice import Lattice

Floats = NDArray[np.float64]


def deterministic_std(lattice: Lattice, snapshots: Any, snr: Any) -> Floats:
    """Bound on the standard deviation of u (rad); `snr` is linear, per element."""
    m, ratio = np.asarray(snapshots, np.float64), np.asarray(snr, np.float64)
    std: Floats = np.sqrt(1 / (2 * m * ratio * lattice.moment))
    return std


def stochastic_std(lattice: Lattice, snapshots: Any, snr: Any) -> Floats:
    """Bound on the standard deviation of u (rad); `snr` is linear, per element."""
    ratio = np.asarray(snr, np.float64)
    variance = 1 / (2 * snapshots * ratio * lattice.moment) * (1 + 1 / (lattice.size * ratio))
    std: Floats = np.sqrt(variance)
    return std


def information_scale(size: int, snapshots: Any, snr: Any) -> Floats:
    """What makes Fisher information of a direction out of the phases of elements, in the stochastic bound.

    With phi_n the phases of the steering vector, the information on parameters i and j is the scale times
    sum_n (d_i phi_n - mean) (d_j phi_n - mean), whatever the array (Stoica and Nehorai 1990).
    """
    ratio = np.asarray(snr, np.float64)
    scale: Floats = 2 * np.asarray(snapshots, np.float64) * ratio / (1 + 1 / (size * ratio))
    return scale


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


def minnorm_excess(lattice: Lattice) -> float:
    """How many times MUSIC's variance that of Min-Norm by both ends is; (N + 1) / 6 for large even rows.

    Both spectra are aᴴWa, W inside the noise subspace, where the signal vector's error is isotropic: var(u)
    goes as dᴴW²d / (dᴴWd)² with d = da/du, and W = P for MUSIC, P (e_1 e_1ᴴ + e_N e_Nᴴ) P for Min-Norm
    (Stoica and Nehorai 1990, section IV).
    """
    d = lattice.centred
    ends = np.zeros(lattice.size)
    ends[[0, -1]] = d[[0, -1]]
    inside = ends - ends.mean()
    return float(lattice.moment * (inside @ inside) / (ends @ d) ** 2)


def theta_std(array: ArrayGeometry, theta: Any, snr: Any, frames: Any, *, stochastic: bool = True) -> Floats:
    """Bound on theta (rad) at true `theta`, with a snapshot per frame and tone that counts."""
    bound = stochastic_std if stochastic else deterministic_std
    lattice, step = Lattice.of_antennas(array)
    u = bound(lattice, np.asarray(frames) * int(array.live_tones.sum()), snr)
    std: Floats = u / (step * array.theta_phase * array.middle_hz / array.carrier_hz * np.sin(theta))
    return std


def rho_std(array: ArrayGeometry, snr: Any, frames: Any, *, stochastic: bool = True) -> Floats:
    """Bound on rho (m), with a snapshot per frame and antenna that counts."""
    bound = stochastic_std if stochastic else deterministic_std
    lattice, step = Lattice.of_tones(array)
    return bound(lattice, np.asarray(frames) * int(array.live_antennas.sum()), snr) / abs(
        step * array.rho_phase
    )
