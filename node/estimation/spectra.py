"""The spectral methods: from a covariance R to a factor X; ‖Xᴴa(u)‖² has its extremum at the estimate.

    Bartlett   X Xᴴ = R                     the power a beam steered at u receives          maximum
    MVDR       X Xᴴ = (R + loading)^-1      one over the power of Capon's beam              minimum
    MUSIC      X = S                        the share of a(u) in the signal subspace        maximum
    Min-Norm   X = (I - S Sᴴ) [e_1 e_N]     the noise subspace's vectors of least norm      minimum

Bartlett needs no function: its X are the snapshots. None of this knows where a(u) comes from: that is for
`manifold`. Functions work on batches (K, N, N) in the precision they are given.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complexfloating[Any, Any]]

MAXIMUM = frozenset({"bartlett", "music"})
"""Methods that look for the maximum of ‖Xᴴa‖²; the others look for its minimum."""


def mvdr(r: Complex, loading: float) -> Complex:
    """X (K, N, N) with X Xᴴ = (R / level + loading I)^-1, level the mean eigenvalue (Capon 1969).

    From the Cholesky factor L: X = L^-H. A plain inverse would lose the null's depth in single precision.
    """
    n = r.shape[-1]
    level = np.trace(r, axis1=1, axis2=2).real / n
    scaled = r / level[:, None, None]
    scaled[:, np.arange(n), np.arange(n)] += r.real.dtype.type(loading)
    return triangular_inverse(np.linalg.cholesky(scaled)).conj().swapaxes(1, 2)


def minnorm(signal: Complex) -> Complex:
    """X = (I - S Sᴴ) [e_1 e_N] (K, N, 2) from orthonormal signal vectors S (K, N, order).

    The vectors of the noise subspace with first (Kumaresan and Tufts 1983) or last element fixed and least
    norm. Either alone leans on one end of the array: a curved wavefront then biases it, and its variance is
    (N + 1) / 3 times MUSIC's; both together cancel the one and halve the other. Columns of zeros in S count
    as absent.
    """
    n = signal.shape[1]
    w: Complex = np.matmul(-signal, signal[:, [0, n - 1]].conj().swapaxes(1, 2))
    w[:, [0, n - 1], [0, 1]] += w.real.dtype.type(1)
    return w


def triangular_inverse(lower: Complex) -> Complex:
    """Inverse of lower triangular matrices (K, N, N), by halves: most of the work is matrix products."""
    n = lower.shape[-1]
    if n <= 8:
        inverse: Complex = np.linalg.inv(lower)
        return inverse
    h = n // 2
    out = np.zeros_like(lower)
    upper_left = out[:, :h, :h] = triangular_inverse(lower[:, :h, :h])
    lower_right = out[:, h:, h:] = triangular_inverse(lower[:, h:, h:])
    np.matmul(-lower_right, np.matmul(lower[:, h:, :h], upper_left), out=out[:, h:, :h])
    return out
