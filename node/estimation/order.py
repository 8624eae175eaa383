"""How many eigenvectors span the signal: fixed, by eigenvalue threshold, or by minimum description length."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.floating[Any]]
Complex = NDArray[np.complexfloating[Any, Any]]
Orders = NDArray[np.intp]


def threshold(eigenvalues: Real, fraction: float) -> Orders:
    """How many of the eigenvalues (K, N) exceed `fraction` of the largest; at least 1, at most N - 1."""
    above = (eigenvalues > fraction * eigenvalues.max(axis=1, keepdims=True)).sum(axis=1)
    orders: Orders = np.clip(above, 1, eigenvalues.shape[1] - 1)
    return orders


def mdl(eigenvalues: Real, snapshots: NDArray[Any]) -> Orders:
    """Minimum description length (Wax and Kailath 1985); at least 1, at most N - 1.

    Parameters
    ----------
    eigenvalues
        (K, N) of the sample covariances, in any order.
    snapshots
        (K,) number of snapshots M. Where M < N the sample covariance is singular; the noise
        eigenvalues are then judged over the M that are not zero.
    """
    n = eigenvalues.shape[1]
    falling = -np.sort(-eigenvalues.astype(np.float64), axis=1)
    floor = np.finfo(eigenvalues.dtype).eps * falling[:, :1]
    falling = np.maximum(falling, floor)
    m = np.asarray(snapshots, np.float64)[:, None]
    k = np.arange(n)
    usable = np.minimum(n, np.maximum(np.floor(m), 2)).astype(np.intp)
    inside = k < usable
    tail_sum = np.cumsum(np.where(inside, falling, 0)[:, ::-1], axis=1)[:, ::-1]
    tail_log = np.cumsum(np.where(inside, np.log(falling), 0)[:, ::-1], axis=1)[:, ::-1]
    rest = np.maximum(usable - k, 1)
    likelihood = m * (rest * np.log(np.maximum(tail_sum, floor) / rest) - tail_log)
    length = likelihood + 0.5 * k * (2 * n - k) * np.log(m)
    length = np.where(inside & (k < n), length, np.inf)
    orders: Orders = np.clip(np.argmin(length, axis=1), 1, n - 1)
    return orders


def leading(vectors: Complex, orders: Orders) -> Complex:
    """The last `orders` (K,) of the eigenvectors (K, N, N), last first; zeros beyond a UE's order."""
    most = int(orders.max())
    signal = vectors[:, :, : -most - 1 : -1].copy()
    signal *= (np.arange(most) < orders[:, None])[:, None, :]
    return signal
