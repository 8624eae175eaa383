"""Lag polynomials on points all round the circle: by one real product where rows are short, else by FFTs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from chachart.node.estimation.manifold import polynomial_table
from chachart.node.estimation.products import row_products

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.floating[Any]]

TABLE_LIMIT = 128
"""Up to so many lags the table stays in the cache, and the product is faster than transforms."""


class Circle:
    """Re sum_k c_k exp(j k u) at u = 2 pi (i + first) / points, i = 0 ... points - 1.

    Parameters
    ----------
    lags
        (L,) whole numbers k, below `points`.
    points
        How many.
    first
        Number of the first point.
    dtype
        Of the values.
    """

    def __init__(
        self, lags: NDArray[np.int64], points: int, first: int = 0, dtype: type[np.floating[Any]] = np.float64
    ) -> None:
        self._lags, self._points, self._first, self._dtype = lags, points, first, dtype
        self._table: Floats | None = None
        if len(lags) <= TABLE_LIMIT:
            u = 2 * np.pi * (np.arange(points) + first) / points
            self._table = polynomial_table(u, lags).astype(dtype)

    def values(self, c: Complex) -> Floats:
        """Values (U, points) of polynomials c (U, L)."""
        kind = np.complex64 if self._dtype is np.float32 else np.complex128
        c = np.ascontiguousarray(c, kind)
        if self._table is not None:
            return row_products(c.view(self._dtype), self._table)
        spread = np.zeros((len(c), self._points), kind)
        spread[:, self._lags] = c
        circle: Floats = fft.ifft(spread, axis=1, norm="forward", overwrite_x=True).real
        return np.roll(circle, -self._first, axis=1)
