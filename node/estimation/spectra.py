"""The spectral methods: from a covariance R to a factor X; ‖Xᴴa(u)‖² has its extremum at the estimate.

    Bartlett   X Xᴴ = R                     the power a beam steered at u receives          maximum
    MVDR       X Xᴴ = (R + loading)^-1      one over the power of Capon's beam              minimum
    MUSIC      X = S                        the share of a(u) in the signal subspace        maximum
    Min-Norm   X = (I - S Sᴴ) [e_1 e_N]     the noise subspace's vectors of least norm      minimum

Bartlett needs no function: its X are the snapshots. None of this knows where a(u) comes from: that is for
`manifold`. Functions work on batches (K, N, N) in the precision they are given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.native import Kernels

Complex = NDArray[np.complexfloating[Any, Any]]
Real = NDArray[np.floating[Any]]

MAXIMUM = frozenset({"bartlett", "music"})
"""Methods that look for the maximum of ‖Xᴴa‖²; the others look for its minimum."""


_SMALL = 8


def mvdr(r: Complex, loading: float) -> Complex:
    """X (K, N, N) with X Xᴴ = (R / level + loading I)^-1, level the mean eigenvalue (Capon 1969).

    With the Cholesky factor L, X = L^-H. A plain inverse would lose the null's depth in single precision.
    """
    n = r.shape[-1]
    per_level = n / np.einsum("kii->k", r).real
    reals = np.ascontiguousarray(r).view(r.real.dtype)
    scaled: Complex = (reals * per_level[:, None, None]).view(r.dtype)
    scaled[:, np.arange(n), np.arange(n)] += r.real.dtype.type(loading)
    return inverse_cholesky(scaled).conj().swapaxes(1, 2)


def minnorm(signal: Complex, ends: NDArray[np.intp] | None = None) -> Complex:
    """X = (I - S Sᴴ) [e_1 e_N] (K, N, 2) from orthonormal signal vectors S (K, N, order).

    `ends` are the elements in place of the first and the last one, the outer ones of an array that is no
    line.

    The vectors of the noise subspace with first (Kumaresan and Tufts 1983) or last element fixed and least
    norm. Either alone leans on one end of the array: a curved wavefront then biases it, and its variance is
    (N + 1) / 3 times MUSIC's; both together cancel the one and halve the other. Columns of zeros in S count
    as absent.
    """
    n = signal.shape[1]
    fixed = np.array([0, n - 1]) if ends is None else ends
    w: Complex = np.matmul(-signal, signal[:, fixed].conj().swapaxes(1, 2))
    w[:, fixed, np.arange(len(fixed))] += w.real.dtype.type(1)
    return w


def inverse_cholesky(r: Complex) -> Complex:
    """L^-1 where R = L Lᴴ (K, N, N) is positive definite, by halves: most of the work is matrix products.

    NaN for those of the batch that are not.
    """
    n = r.shape[-1]
    if Kernels.here and Kernels.take(r, n):
        return Kernels.here.inverse_cholesky(r)
    if n <= _SMALL:
        return _triangular_inverse(_each(np.linalg.cholesky, r))
    h = n // 2
    out = np.zeros_like(r)
    upper = out[:, :h, :h] = inverse_cholesky(r[:, :h, :h])
    below = np.matmul(r[:, h:, :h], upper.conj().swapaxes(1, 2))
    lower = out[:, h:, h:] = inverse_cholesky(r[:, h:, h:] - np.matmul(below, below.conj().swapaxes(1, 2)))
    np.matmul(-lower, np.matmul(below, upper), out=out[:, h:, :h])
    return out


def eigh(r: Complex) -> tuple[Real, Complex]:
    """Eigenvalues (K, N), ascending, and eigenvectors of Hermitian matrices; NaN where there are none."""
    try:
        return np.linalg.eigh(r)
    except np.linalg.LinAlgError:
        values = _each(lambda part: np.linalg.eigh(part)[0], r)
        return values, _each(lambda part: np.linalg.eigh(part)[1], r)


def _each(decompose: Callable[[Complex], NDArray[Any]], r: Complex) -> NDArray[Any]:
    """A decomposition of a batch, NaN for the matrices that have none instead of an error for them all."""
    try:
        return decompose(r)
    except np.linalg.LinAlgError:
        if len(r) == 1:
            return np.full_like(decompose(np.eye(r.shape[-1], dtype=r.dtype)[None]), np.nan)
        half = len(r) // 2
        return np.concatenate([_each(decompose, r[:half]), _each(decompose, r[half:])])


def _triangular_inverse(lower: Complex) -> Complex:
    """Inverse of small lower triangular matrices (K, n, n) by substitution, the batch innermost."""
    rows = np.ascontiguousarray(lower.transpose(1, 2, 0))
    out = np.zeros_like(rows)
    for i in range(len(rows)):
        out[i, i] = 1 / rows[i, i].real
        if i:
            np.multiply((rows[i, :i, None] * out[:i, :i]).sum(axis=0), -out[i, i], out=out[i, :i])
    return out.transpose(2, 0, 1)
