"""Products of many rows with a table, the same to the bit whatever rows are beside them.

Libraries sum a product of matrices in another order where rows are few, or left over from what a kernel
takes at a time. What is told apart by little more than rounding would then depend on the block it came in.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

AT_A_TIME: Final = 8
"""Rows of a product: so many that kernels treat all alike, be they for AVX-512, AVX2 or older."""


def row_products(rows: NDArray[Any], table: NDArray[Any]) -> NDArray[Any]:
    """rows (K, L) times a table (L, G): (K, G)."""
    count, length = rows.shape
    pieces = -(-count // AT_A_TIME)
    if count < pieces * AT_A_TIME:
        filled = np.zeros((pieces * AT_A_TIME, length), rows.dtype)
        filled[:count] = rows
        rows = filled
    product: NDArray[Any] = np.matmul(rows.reshape(pieces, AT_A_TIME, length), table)
    return product.reshape(pieces * AT_A_TIME, table.shape[1])[:count]
