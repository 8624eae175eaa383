"""A scatter plot in braille characters, two by four dots each, coloured cell by cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_BLANK = 0x2800
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], np.uint8)
"""Bit of each dot of a character, by row and column."""

Bounds = tuple[float, float, float, float]


def fit(x: NDArray[Any], y: NDArray[Any], columns: int, rows: int) -> Bounds:
    """Bounds (left, right, bottom, top) that show nearly all points, with one scale for both axes.

    One point in a hundred may lie outside at each side, so that a few outliers do not shrink the rest.
    """
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        return -1.0, 1.0, -1.0, 1.0
    left, right = np.percentile(x[known], [1, 99])
    bottom, top = np.percentile(y[known], [1, 99])
    # Dots are as wide as high: 2 in a column, 4 in a row.
    scale = 1.1 * max((right - left) / (2 * columns), (top - bottom) / (4 * rows), 1e-6)
    middle_x, middle_y = (left + right) / 2, (bottom + top) / 2
    half_x, half_y = scale * columns, scale * 2 * rows
    return middle_x - half_x, middle_x + half_x, middle_y - half_y, middle_y + half_y


def scatter(
    x: NDArray[Any], y: NDArray[Any], bounds: Bounds, columns: int, rows: int
) -> tuple[NDArray[np.uint8], NDArray[np.intp]]:
    """Dots of each character, (rows, columns), first row on top, and for each the last point in it, else -1.

    Points outside the bounds, or not finite, are left out.
    """
    left, right, bottom, top = bounds
    with np.errstate(invalid="ignore"):
        across = np.floor((x - left) / (right - left) * 2 * columns)
        down = np.floor((top - y) / (top - bottom) * 4 * rows)
        inside = (across >= 0) & (across < 2 * columns) & (down >= 0) & (down < 4 * rows)
    point = np.flatnonzero(inside)
    i, j = down[inside].astype(np.intp), across[inside].astype(np.intp)
    dots = np.zeros((rows, columns), np.uint8)
    np.bitwise_or.at(dots, (i // 4, j // 2), _DOTS[i % 4, j % 2])
    owner = np.full((rows, columns), -1, np.intp)
    owner[i // 4, j // 2] = point
    return dots, owner


def characters(dots: NDArray[np.uint8]) -> list[str]:
    """The rows of a plot as text."""
    return ["".join(chr(_BLANK + bits) for bits in row) for row in dots.tolist()]
