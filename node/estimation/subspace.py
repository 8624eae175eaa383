"""The signal subspace of every UE, tracked: a few steps of orthogonal iteration from where it was a frame
ago.

A full eigendecomposition costs a hundred times the product R Q, and MUSIC and Min-Norm need no more of R
than the span of a few eigenvectors. That span moves little from frame to frame, so iterating from the last
one converges in two or three steps; whatever does not converge is decomposed in full.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.covariance import Bank
from chachart.node.estimation.spectra import eigh
from chachart.node.estimation.state import Slots, SlotState

Complex = NDArray[np.complexfloating[Any, Any]]
Real = NDArray[np.floating[Any]]

STEPS: Final = 24
"""Steps after which subspaces that still move are left to the full decomposition ..."""
FEW: Final = 1 / 16
"""... and when no more than this share of a block is left, at once: a step for so few costs too much."""
TOLERANCE: Final = 0.03
"""What is left to converge, as a share of what the sample covariance is uncertain by."""

FREE_STEPS: Final = 1
"""Steps before the first check."""
NOISE_LIKE: Final = 6.0
"""Vectors after the first, with eigenvalues up to so many times the noise's, count as noise: what is left to
converge of them hardly moves the first one's null, and from frame to frame they converge anyway."""

_ROUNDING: Final = 8 * float(np.finfo(np.float32).eps)
_TINY: Final = np.float32(1e-30)


class SubspaceTracker(SlotState):
    """Bases (order, N) by slot whose rows are the conjugates of orthonormal signal vectors: B = Sᴴ.

    Parameters
    ----------
    size, order
        N and the number of vectors.
    """

    def __init__(self, size: int, order: int) -> None:
        self.size, self.order = size, order
        self._bank = Bank((order, size), np.complex64)
        start = np.random.default_rng(0).standard_normal((order, size, 2), np.float32)
        self._start: NDArray[np.complex64] = start.view(np.complex64)[..., 0]
        super().__init__(bank=self._bank)

    def update(self, slots: Slots, r: Complex, snapshots: Real) -> Complex:
        """Bases (U, order, N) for the covariances r (U, N, N) of `slots`, each from `snapshots` (U,)."""
        basis = self._bank.rows[slots]
        first = basis[:, 0].view(np.float32)
        cold = ~(np.einsum("kn,kn->k", first, first) > 0.5)  # nothing yet, or NaN
        if cold.any():
            rows = np.matmul(self._start, r[cold])
            basis[cold] = orthonormal(rows / np.abs(rows).max(axis=(1, 2), keepdims=True))
        basis = iterate(r, basis, snapshots)
        self._bank.rows[slots] = basis
        return basis


def dominant(r: Complex, order: int) -> Complex:
    """Conjugates (K, order, N) of the dominant eigenvectors of r (K, N, N), by full decomposition."""
    vectors = eigh(r)[1][:, :, : -order - 1 : -1]
    basis: Complex = vectors.conj().swapaxes(1, 2)
    return basis


def iterate(r: Complex, basis: Complex, snapshots: Real) -> Complex:
    """Orthogonal iteration from `basis` (K, order, N) until the part of B R outside of B's span is small.

    Small against sqrt(lambda_i lambda_noise / M), which is how far sampling itself throws R q_i: over the
    same eigengap both give errors of q_i, so the gap cancels. Vectors after the first that look like noise
    need not converge. The first one always has to: what it still lacks makes it look weaker than it is.
    """
    result = basis
    todo = np.arange(len(r))
    scale = (1 / np.einsum("kii->k", r).real)[:, None, None]  # single precision cannot square any r
    for step in range(STEPS):
        onward = np.matmul(basis, r) * scale
        if step >= FREE_STEPS:
            open_ = _unconverged(basis, onward, snapshots)
            if len(todo) == len(result):
                result = basis
            else:
                result[todo] = basis
            if not open_.any():
                return result
            if not open_.all():
                todo, r, onward = todo[open_], r[open_], onward[open_]
                scale, snapshots = scale[open_], snapshots[open_]
            if len(todo) <= len(result) * FEW:
                break
        basis = orthonormal(onward)
    result[todo] = dominant(r, basis.shape[1])
    return result


def orthonormal(rows: Complex) -> Complex:
    """Gram-Schmidt over the rows (K, order, N) in order, in place, across the whole batch at once."""
    for i in range(rows.shape[1]):
        row, rest = rows[:, i : i + 1], rows[:, i + 1 :]
        reals = row.view(row.real.dtype)
        row *= 1 / np.sqrt(np.maximum(np.einsum("kin,kin->ki", reals, reals), _TINY))[:, :, None]
        if rest.shape[1]:
            rest -= np.matmul(np.matmul(rest, row.conj().swapaxes(1, 2)), row)
    return rows


def _unconverged(basis: Complex, onward: Complex, snapshots: Real) -> NDArray[np.bool_]:
    """Which bases B with onward = B R, R of trace 1, have a signal vector that still moves, (K,)."""
    order, n = basis.shape[1:]
    inner = np.matmul(onward, basis.conj().swapaxes(1, 2))
    reals = (onward - np.matmul(inner, basis)).view(onward.real.dtype)
    residual = np.einsum("kon,kon->ko", reals, reals)
    value = np.einsum("koo->ko", inner).real
    noise = (np.maximum(1 - value.sum(axis=1), 0) / (n - order))[:, None]
    m = snapshots[:, None]
    bulk = np.where(np.arange(order) == 0, 0, NOISE_LIKE) * noise
    allowed = TOLERANCE**2 * value * noise / m + _ROUNDING**2
    moving: NDArray[np.bool_] = ((value > bulk) & (residual > allowed)).any(axis=1)
    return moving
