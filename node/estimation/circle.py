"""Lag polynomials on points of the circle: by one real product where rows are short, else by FFTs."""

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
    """Re sum_k w_k c_k exp(j k u) at u = 2 pi i / points for some whole i.

    Parameters
    ----------
    lags
        (L,) whole numbers k, below `points`.
    points
        How many there are all round.
    at
        (P,) those that are wanted, i.
    dtype
        Of the values.
    window
        (L,) w_k; None for 1.
    """

    def __init__(
        self,
        lags: NDArray[np.int64],
        points: int,
        at: NDArray[np.intp],
        dtype: type[np.floating[Any]] = np.float64,
        window: NDArray[np.float64] | None = None,
    ) -> None:
        self._lags, self._points, self._at = lags, points, at % points
        self._dtype, self._kind = dtype, np.complex64 if dtype is np.float32 else np.complex128
        self._window = np.ones(len(lags)) if window is None else window
        self._table: Floats | None = None
        if len(lags) <= TABLE_LIMIT:
            table = polynomial_table(2 * np.pi * self._at / points, lags)
            self._table = (np.repeat(self._window, 2)[:, None] * table).astype(dtype)

    def values(self, c: Complex) -> Floats:
        """Values (U, P) of polynomials c (U, L)."""
        if self._table is not None:
            return row_products(np.ascontiguousarray(c, self._kind).view(self._dtype), self._table)
        spread = np.zeros((len(c), self._points), self._kind)
        spread[:, self._lags] = c * self._window
        circle: Floats = fft.ifft(spread, axis=1, norm="forward", overwrite_x=True).real
        return circle[:, self._at]
