"""Boards: elements on a uniform grid, whose spectrum is a lag polynomial in two variables, exactly.

With a_n = exp(j (column_n u + row_n v)), u = 2 pi d_column / wavelength d.right, v = 2 pi d_row /
wavelength d.up, aᴴQa is Re sum_kl c_lk exp(j (k u + l v)) where c_lk sums Q over the pairs of elements that
are k columns and l rows apart.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.elements import lattice
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.directions.manifold import PER_CELL, DirectionManifold
from chachart.node.estimation.manifold import powers

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

_SCRATCH_BYTES = 1 << 20


class BoardManifold(DirectionManifold):
    """Rows times columns. Features are lags (K, L), rows -R + 1 ... R - 1 by columns 0 ... C - 1.

    Raises
    ------
    ValueError
        If the elements are no board.
    """

    def __init__(self, array: ArrayGeometry) -> None:
        super().__init__(array)
        own = array.own_elements[array.live_antennas]
        board = lattice(own)
        if board is None:
            raise ValueError(f"{array.name} is no board")
        wave = 2 * np.pi * array.middle_hz / array.light_speed_m_s
        self.phase = np.array([wave * board.column_spacing_m, wave * board.row_spacing_m])
        self.shape = 2 * board.rows - 1, board.columns
        self.rows, self.columns = board.rows, board.columns
        self.row, self.column = board.row, board.column
        apart = board.column - board.column[:, None], board.row - board.row[:, None]
        half = (apart[0] > 0) | ((apart[0] == 0) & (apart[1] >= 0))
        place = ((apart[1] + board.rows - 1) * board.columns + apart[0])[half]
        order = np.argsort(place, kind="stable")
        self._pairs = np.flatnonzero(half.ravel())[order]
        self._slots, self._starts = np.unique(place[order], return_index=True)
        self._centre = (board.rows - 1) * board.columns
        twice = np.full(len(self._slots), 2, np.float32)
        twice[self._slots == self._centre] = 1
        self._twice = twice
        self.points = self.grid(PER_CELL)[0]

    def grid(self, per_cell: float) -> tuple[Floats, Floats]:
        """See `DirectionManifold`: even in u and v, as far as they can be told apart."""
        axes, steps = [], []
        for size, phase in ((self.columns, self.phase[0]), (self.rows, self.phase[1])):
            if size == 1:
                axes.append(np.linspace(-1, 1, 5))
                steps.append(0.5)
                continue
            edge = min(phase, np.pi)
            count = int(np.ceil(2 * edge / (2 * np.pi / size / per_cell))) + 1
            axes.append(np.linspace(-edge, edge, count) / phase)
            steps.append(axes[-1][1] - axes[-1][0])
        right, up = (a.ravel() for a in np.meshgrid(*axes))
        inside = right**2 + up**2 < 1
        right, up = right[inside], up[inside]
        normal = np.sqrt(1 - right**2 - up**2)
        side = 1.0 if self.plane is None else self.plane[2]
        points = np.stack([right, up, side * normal], axis=1)
        if self.facing is not None:
            points = points[points @ self.facing > -1e-9]
        return points, points[:, :2] / steps

    def features(self, x: Complex, conjugate: Complex) -> Complex:
        """Lags (K, L) of X Xᴴ for factors x (K, N, M), some at a time."""
        out = np.zeros((len(x), self.shape[0] * self.shape[1]), x.dtype)
        across = conjugate.swapaxes(1, 2)
        step = max(_SCRATCH_BYTES // (self.size**2 * x.itemsize), 1)
        for i in range(0, len(x), step):
            part = slice(i, i + step)
            out[part] = self.of_matrices(np.matmul(x[part], across[part]))
        return out

    def of_matrices(self, q: Complex) -> Complex:
        """Lags (K, L) of Hermitian matrices q (K, N, N)."""
        pairs = q.reshape(len(q), -1)[:, self._pairs]
        out = np.zeros((len(q), self.shape[0] * self.shape[1]), q.dtype)
        out[:, self._slots] = np.add.reduceat(pairs, self._starts, axis=1) * self._twice
        return out

    def trace(self, features: Complex) -> NDArray[Any]:
        """tr Q (K,): the lag of no distance."""
        total: NDArray[Any] = features[:, self._centre].real
        return total

    def table(self, points: Floats) -> Floats:
        """(2 L, G): cosine and minus sine of k u + l v."""
        u, v = self.phase[0] * points[:, 0], self.phase[1] * points[:, 1]
        row = np.arange(self.shape[0])[:, None, None] - (self.rows - 1)
        angle = np.arange(self.columns)[:, None] * u + row * v
        return np.stack([np.cos(angle), -np.sin(angle)], axis=2).reshape(-1, len(points))

    def derivatives(self, features: Complex, d: Floats, e: Floats) -> tuple[Floats, Floats, Floats]:
        """See `DirectionManifold`; by the polynomial's derivatives by u and v."""
        u, v = self.phase[0] * d[:, 0], self.phase[1] * d[:, 1]
        k = np.arange(self.columns, dtype=np.float64)
        row = np.arange(self.shape[0], dtype=np.float64) - (self.rows - 1)
        terms = features.T.reshape(*self.shape, -1) * powers(u, self.columns)
        sums = (np.stack([np.ones_like(k), k, k * k]) @ terms.view(np.float64)).view(np.complex128)
        sums *= (powers(v, self.shape[0]) * np.exp(-1j * (self.rows - 1) * v))[:, None]
        by_row = sums.reshape(self.shape[0], -1).view(np.float64)
        weights = np.stack([np.ones_like(row), row, row * row])
        f = (weights @ by_row).view(np.complex128).reshape(3, 3, -1)  # [power of l, power of k]
        value = f[0, 0].real
        fu, fv = -f[0, 1].imag, -f[1, 0].imag
        fuu, fuv, fvv = -f[0, 2].real, -f[1, 1].real, -f[2, 0].real
        u1, u2 = self.phase[0] * e[:, :, 0]
        v1, v2 = self.phase[1] * e[:, :, 1]
        slope = np.stack([fu * u1 + fv * v1, fu * u2 + fv * v2])
        down = 0.0 if self.flat else fu * u + fv * v
        bend = np.stack(
            [
                fuu * u1 * u1 + 2 * fuv * u1 * v1 + fvv * v1 * v1 - down,
                fuu * u1 * u2 + fuv * (u1 * v2 + u2 * v1) + fvv * v1 * v2,
                fuu * u2 * u2 + 2 * fuv * u2 * v2 + fvv * v2 * v2 - down,
            ]
        )
        return value, slope, bend
