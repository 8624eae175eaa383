"""How an array can be described wrongly and still look like itself: mirrored, turned, counted another way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.elements import lattice, least_distance
from chachart.node.data.geometry import ArrayGeometry

Order = NDArray[np.intp]
Floats = NDArray[np.float64]


def symmetries(array: ArrayGeometry) -> dict[str, Order]:
    """Orders of the inputs, by what is wrong with a description that makes them necessary.

    For each element the input that it is connected to, as in `Calibration.antenna_order`.
    """
    own = array.own_elements
    found: dict[str, Order] = {}
    limit = 1e-3 * least_distance(own) if len(own) > 1 else 0.0
    for name, moved in _images(own, array.is_line):
        apart = np.linalg.norm(moved[:, None] - own, axis=2)
        order: Order = apart.argmin(axis=1)
        if apart.min(axis=1).max() <= limit and (order != np.arange(len(own))).any():
            found.setdefault(name, order)
    board = lattice(own)
    if board is not None and min(board.rows, board.columns) > 1:
        counted = (board.rows - 1 - board.row) + board.rows * board.column
        found.setdefault("numbered column by column", counted)
    return found


def _images(own: Floats, line: bool) -> Iterator[tuple[str, Floats]]:
    """What is wrong, and where each element then really is."""
    if line:
        yield "numbered from the other end", own * [-1, 1, 1]
        return
    flat = np.ptp(own[:, 1]) < 1e-9
    if not flat:
        yield "columns are mirrored: left is right", own * [-1, 1, 1]
        yield "rows are mirrored: top is bottom", own * [1, -1, 1]
        yield "turned by 180 degrees", own * [-1, -1, 1]
        yield "rows are columns, mirrored at the diagonal", own[:, [1, 0, 2]]
        yield "rows are columns, mirrored at the other diagonal", own[:, [1, 0, 2]] * [-1, -1, 1]
        yield "turned by 90 degrees to the left", own[:, [1, 0, 2]] * [-1, 1, 1]
        yield "turned by 90 degrees to the right", own[:, [1, 0, 2]] * [1, -1, 1]
    for step in range(len(own)) if flat else ():
        angle = 2 * np.pi * step / len(own)
        turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
        if step:
            yield f"turned by {step} elements", own @ turn
        yield (
            f"counted the other way round{f', from element {step}' if step else ''}",
            (own * [-1, 1, 1]) @ turn,
        )
