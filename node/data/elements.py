"""Where the elements of an array sit in its own frame, and what shape that is.

The own frame has the axes (right, up, normal), right x up = normal, as somebody in front of the array sees
it: right is this person's right hand, normal points towards the person. Elements are (N, 3) in metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FLAT = 1e-3
"""Elements are in a plane, a line or a lattice if they are off it by less than so much of their spacing."""


def line(count: int, spacing_m: float) -> Floats:
    """`count` elements from left to right, about the origin."""
    return grid(1, count, spacing_m, spacing_m)


def grid(rows: int, columns: int, column_spacing_m: float, row_spacing_m: float | None = None) -> Floats:
    """A board about the origin: element row * columns + column, row 0 on top, column 0 on the left.

    `row_spacing_m` is the columns' where it is None.
    """
    x = (np.arange(columns) - (columns - 1) / 2) * column_spacing_m
    y = ((rows - 1) / 2 - np.arange(rows)) * (row_spacing_m or column_spacing_m)
    right, up = np.meshgrid(x, y)
    return np.stack([right.ravel(), up.ravel(), np.zeros(rows * columns)], axis=1)


def circle(count: int, radius_m: float) -> Floats:
    """A circle in the plane of right and normal: element k at azimuth 2 pi k / count, normal to right."""
    angle = 2 * np.pi * np.arange(count) / count
    return radius_m * np.stack([np.sin(angle), np.zeros(count), np.cos(angle)], axis=1)


def check(elements: Any, count: int, least_m: float) -> None:
    """Are these `count` positions at least `least_m` apart?

    Raises
    ------
    ValueError
        If not.
    """
    try:
        places = np.asarray(elements, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"elements must be {count} positions of 3 numbers") from None
    if count < 1 or places.shape != (count, 3) or not np.isfinite(places).all():
        raise ValueError(f"elements must be {count} positions of 3 numbers, not {places.shape}")
    if count > 1 and least_distance(places) <= least_m:
        raise ValueError("elements must be in different places; they are in metres")


def check_shape(array: Any, sees: tuple[Any, ...], shares: tuple[Any, ...]) -> None:
    """Do an `ArrayGeometry`'s elements, pattern, view and clock fit each other?

    Raises
    ------
    ValueError
        If not.
    """
    if array.elements is not None:
        check(array.elements, array.antennas, 1e-3 * array.wavelength_m)
    for name, known in (("sees", sees), ("clock_shares", shares)):
        if (value := getattr(array, name)) not in known:
            raise ValueError(f"{name} must be one of {', '.join(str(k) for k in known if k)}, not {value!r}")
    if array.pattern is not None and array.pattern.elements != array.antennas:
        raise ValueError(f"the pattern is of {array.pattern.elements} elements, not {array.antennas}")
    if array.clock is not None and (type(array.clock) is not str or not array.clock):
        raise ValueError(f"clock must be a name, not {array.clock!r}")


def first_of_line(
    elements: Floats,
    position_m: tuple[float, ...] = (0.0, 0.0, 0.0),
    axis: tuple[float, ...] = (0.0, 1.0, 0.0),
    broadside: tuple[float, ...] = (1.0, 0.0, 0.0),
    **_: Any,
) -> tuple[float, float, float]:
    """World position of element 0 in a frame with this pose."""
    frame = np.stack([axis, np.cross(broadside, axis), broadside])
    x, y, z = (np.asarray(position_m) + elements[0] @ frame).tolist()
    return (x, y, z)


def least_distance(elements: Floats) -> float:
    """Between any two elements; 0 where two coincide."""
    apart = np.linalg.norm(elements[:, None] - elements, axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min())


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """A board whose elements fill a uniform grid, whatever the order of their numbers.

    Attributes
    ----------
    rows, columns
        How many of each; rows count upwards here, columns to the right.
    row_spacing_m, column_spacing_m
        Distance between neighbours; 0 where there is only one.
    row, column
        intp (N,): where each element is.
    """

    rows: int
    columns: int
    row_spacing_m: float
    column_spacing_m: float
    row: NDArray[np.intp]
    column: NDArray[np.intp]


def lattice(elements: Floats) -> Lattice | None:
    """The grid along right and up that the elements fill, each place once; None if there is none."""
    spacing = least_distance(elements) if len(elements) > 1 else 1.0
    if spacing == 0 or np.ptp(elements[:, 2]) > FLAT * spacing:
        return None
    columns = _places(elements[:, 0], FLAT * spacing)
    rows = _places(elements[:, 1], FLAT * spacing)
    if columns is None or rows is None or columns[1] * rows[1] != len(elements):
        return None
    if len(np.unique(rows[0] * columns[1] + columns[0])) < len(elements):
        return None
    return Lattice(rows[1], columns[1], rows[2], columns[2], rows[0], columns[0])


def mirror(elements: Floats) -> Floats | None:
    """Unit normal (3,) of the plane that all elements are in, on whose two sides they see the same.

    None if they are in no plane, or on a line, which is in many. Of the two normals it is the one whose
    largest component is positive.
    """
    offset = elements - elements.mean(axis=0)
    _, size, axes = np.linalg.svd(offset, full_matrices=True)
    size = np.append(size, np.zeros(3 - len(size)))
    limit = FLAT * least_distance(elements) if len(elements) > 1 else 0.0
    if size[2] > limit or size[1] <= limit:
        return None
    normal: Floats = axes[2]
    return np.asarray(normal * np.sign(normal[np.argmax(np.abs(normal))]))


def on_one_line(elements: Floats) -> bool:
    """Whether all elements are on the line along right through their middle."""
    limit = FLAT * least_distance(elements) if len(elements) > 1 else 0.0
    return bool(np.ptp(elements[:, 1:], axis=0).max() <= limit)


def partners(elements: Floats) -> NDArray[np.intp] | None:
    """For each element the one at the mirrored place through their middle; None if one has none.

    Only with such partners is the conjugate mirror image of a covariance again one of the same array.
    """
    offset = elements - elements.mean(axis=0)
    apart = np.linalg.norm(offset[:, None] + offset, axis=2)
    nearest: NDArray[np.intp] = apart.argmin(axis=1)
    limit = FLAT * least_distance(elements) if len(elements) > 1 else 0.0
    return nearest if apart.min(axis=1).max() <= limit else None


def _places(values: NDArray[Any], tolerance: float) -> tuple[NDArray[np.intp], int, float] | None:
    """On which of equidistant places each value is, how many, how far apart; None if they are not."""
    ordered = np.sort(values)
    jumps = np.diff(ordered) > max(4 * tolerance, 0.0)
    count = int(jumps.sum()) + 1
    if count == 1:
        return np.zeros(len(values), np.intp), 1, 0.0
    spacing = float(ordered[-1] - ordered[0]) / (count - 1)
    place = (values - ordered[0]) / spacing
    nearest = np.rint(place).astype(np.intp)
    if np.abs(place - nearest).max() * spacing > tolerance:
        return None
    return nearest, count, spacing
