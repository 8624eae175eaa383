"""Lag polynomials: sums of N x N Hermitian matrices over pairs of elements of equal lag."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.native import Kernels
from chachart.node.estimation.products import row_products

Complex = NDArray[np.complexfloating[Any, Any]]
Reals = NDArray[np.floating[Any]]

MATMUL_LIMIT = 64
"""Up to this size, lag sums come from the covariance itself; beyond, FFTs need fewer operations."""

FEW = 4
"""Up to so many columns, lag sums of products come from beams all round the circle, which are fewer."""
REAL_LEAST = 16
"""From this size on, products pay in real arithmetic."""

_SCRATCH_BYTES = 1 << 20
_TRANSFORM_BYTES = 4 << 20


class LagSums:
    """The polynomials of aᴴ(u) Q a(u).

    With a_n(u) = exp(j p_n u), aᴴ Q a = Re sum_k c_k exp(j k u) where c_k sums Q's entries of p_m - p_n = k:
    c_0 once, the rest twice. For an even row these are its diagonals; gaps are filled with zeros before.
    Entries of sparse lattices are picked in the order of their lags.
    """

    def __init__(self, lattice: Lattice) -> None:
        self.lattice = lattice
        self._rooms: dict[np.dtype[Any], _Room] = {}
        self._beams: dict[np.dtype[Any], tuple[Reals, Reals]] = {}
        if lattice.sparse:
            first, second = np.triu_indices(lattice.size)
            lag = lattice.index[second] - lattice.index[first]
            order = np.argsort(lag, kind="stable")
            self._entries = (first * lattice.size + second)[order]
            self._starts = np.searchsorted(lag[order], lattice.lags)

    def of(self, q: Complex) -> Complex:
        """Lag polynomials (K, L) of Hermitian matrices q (K, N, N)."""
        if self.lattice.sparse:
            c: Complex = np.add.reduceat(q.reshape(len(q), -1)[:, self._entries], self._starts, axis=1)
            c[:, 1:] *= 2
            return c
        q = self.lattice.spread_out(self.lattice.spread_out(q, 1), 2)
        c = np.empty((len(q), self.lattice.span), q.dtype)
        room = self._room(q.dtype)
        for i in range(0, len(q), room.count):
            part = slice(i, i + room.count)
            room.diagonals_of(q[part], c[part])
        c[:, 1:] *= 2
        return c

    def of_products(self, x: Complex) -> Complex:
        """Lag polynomials (K, L) of X Xᴴ for factors x (K, N, M)."""
        if self.lattice.sparse:
            return self.of(np.matmul(x, x.conj().swapaxes(1, 2)))
        n = self.lattice.span
        if Kernels.here and Kernels.take(x, n) and x.shape[2] > FEW:
            return Kernels.here.lag_sums(self.lattice.spread_out(x, 1))
        if x.shape[2] > FEW and n < REAL_LEAST:
            return self.of(np.matmul(x, x.conj().swapaxes(1, 2)))
        x = self.lattice.spread_out(x, 1)
        if n > MATMUL_LIMIT:
            points = fft.next_fast_len(2 * n)
            step = max(_TRANSFORM_BYTES // (points * x.shape[2] * x.itemsize), 1)
            return np.concatenate(
                [self._of_spectrum(x[i : i + step], points) for i in range(0, len(x), step)]
            )
        if x.shape[2] <= FEW:
            return self._of_beams(x)
        c = np.empty((len(x), n), x.dtype)
        room = self._room(x.dtype)
        step = max(min(room.count, _SCRATCH_BYTES // (2 * n * x.shape[2] * x.itemsize)), 1)
        for i in range(0, len(x), step):
            part = slice(i, i + step)
            room.diagonals_of_products(x[part], c[part])
        c[:, 1:] *= 2
        return c

    def _of_beams(self, x: Complex) -> Complex:
        """As `_of_spectrum`, by products with tables."""
        k, n, m = x.shape
        if x.dtype not in self._beams:
            angles = np.pi / n * np.arange(n)[:, None] * np.arange(2 * n)
            cos, sin = np.cos(angles), np.sin(angles)
            there = np.block([[cos, -sin], [sin, cos]]).reshape(2, n, 4 * n).swapaxes(0, 1).reshape(2 * n, -1)
            back = np.stack([cos, -sin], axis=2).swapaxes(0, 1).reshape(2 * n, -1) / (2 * n)
            real = x.real.dtype
            self._beams[x.dtype] = there.astype(real), back.astype(real)
        there, back = self._beams[x.dtype]
        rows = np.ascontiguousarray(x.swapaxes(1, 2)).reshape(k * m, n)
        beams = row_products(rows.view(there.dtype), there)
        beams *= beams
        power = beams.reshape(k, 2 * m, 2 * n).sum(axis=1)
        c: Complex = row_products(power, back).view(x.dtype)
        c[:, 1:] *= 2
        return c

    def _of_spectrum(self, x: Complex, points: int) -> Complex:
        transform = np.ascontiguousarray(fft.fft(x, points, axis=1))
        reals = transform.view(transform.real.dtype)
        power = np.einsum("kfm,kfm->kf", reals, reals)
        c: Complex = fft.rfft(power, axis=1, norm="forward")[:, : self.lattice.span]
        c[:, 1:] *= 2
        return c

    def _room(self, dtype: np.dtype[Any]) -> _Room:
        if dtype not in self._rooms:
            self._rooms[dtype] = _Room(self.lattice.span, dtype)
        return self._rooms[dtype]


class _Room:
    """Room for as many N x N matrices as stay in the cache, where diagonals lie in columns.

    Matrices are written into the left half of zeros twice as wide. Read with rows one element longer, from
    N - 1 elements before, there are the 2 N - 1 diagonals, from the lower left corner to the upper right one.
    """

    def __init__(self, n: int, dtype: np.dtype[Any]) -> None:
        real = np.empty(0, dtype).real.dtype
        self.n, self.count = n, max(_SCRATCH_BYTES // (4 * n * n * dtype.itemsize), 1)
        memory = [np.zeros(self.count * 2 * n * n + n - 1, kind) for kind in (real, real, dtype)]
        self._real, self._imag, self._complex = (
            one[n - 1 :].reshape(self.count, n, 2 * n)[:, :, :n] for one in memory
        )
        self._diagonals = [
            np.lib.stride_tricks.as_strided(
                one, (self.count, n, 2 * n - 1), (2 * n * n * step, (2 * n + 1) * step, step)
            )
            for one in memory
            for step in one.strides
        ]

    def diagonals_of(self, q: Complex, out: Complex) -> None:
        """Sums of the diagonals of matrices q (K, N, N), from the main one up: (K, N)."""
        np.copyto(self._complex[: len(q)], q)
        upper = self._diagonals[2][: len(q), :, self.n - 1 :]
        out[:] = np.einsum("kij->kj", upper)

    def diagonals_of_products(self, x: Complex, out: Complex) -> None:
        """The same of X Xᴴ, for factors x (K, N, M), in real arithmetic.

        With X = A + j B, it is A Aᵀ + B Bᵀ and j (B Aᵀ - A Bᵀ): the sums of the latter are those of B Aᵀ
        above its diagonal less those below.
        """
        k, n, m = x.shape
        kind = self._real.dtype
        strides = (x.strides[0], kind.itemsize, x.strides[2], x.strides[1])
        parts = np.lib.stride_tricks.as_strided(x.real, (k, 2, m, n), strides).copy()
        stacked = parts.reshape(k, 2 * m, n)
        # a product of one and the same memory goes another way, which is slower for small matrices
        np.matmul(stacked.swapaxes(1, 2), stacked.copy(), out=self._real[:k])
        np.matmul(parts[:, 1].swapaxes(1, 2), parts[:, 0], out=self._imag[:k])
        out.real = np.einsum("kij->kj", self._diagonals[0][:k, :, n - 1 :])
        both = np.einsum("kij->kj", self._diagonals[1][:k])
        np.subtract(both[:, n - 1 :], both[:, n - 1 :: -1], out=out.imag)
