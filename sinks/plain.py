"""Reports and charts as the plain values that JSON can hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def plain(value: Any) -> Any:
    """The same with plain numbers and lists; what is not finite becomes None, as JSON has no word for it."""
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(v) for key, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value


def rounded(column: NDArray[Any], decimals: int) -> list[Any]:
    """A column of numbers to so many decimals, None where not finite; much quicker than `plain`."""
    with np.errstate(over="ignore"):
        numbers = np.round(column.astype(np.float64), decimals)
    values: list[Any] = numbers.tolist()
    for row in np.flatnonzero(~np.isfinite(numbers)).tolist():
        values[row] = None
    return values
