"""Where the UEs of a scenario are.

A layout is drawn in the array's own horizontal frame (x ahead of it, y along it) and then placed in the
world, so that it lies before the array wherever that stands. All layouts fill the area of the reference
scenario, or the one they are told.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry

Floats = NDArray[np.float64]
LayoutName = Literal["vip", "uniform", "grid"]

Area = tuple[tuple[float, float], tuple[float, float]]
AREA_M: Area = ((100.0, 600.0), (-500.0, 500.0))
"""Extent of every layout ahead of the array (x) and along it (y)."""
LETTER_UES = 234
"""So many UEs draw the letters of the `vip` layout."""
UE_HEIGHT_M = 1.5
"""Height of the UEs above the ground, world z."""

_LETTER_HEIGHT_M = 280.0
_LAYOUT_STREAM = 1
_HEIGHT_STREAM = 6


def place(
    name: LayoutName,
    ues: int,
    array: ArrayGeometry,
    seed: int = 0,
    ue_height_m: float = UE_HEIGHT_M,
    area: Area = AREA_M,
    highest_m: float | None = None,
) -> Floats:
    """World positions (ues, 3) in metres of a named layout, the same for the same seed.

    It is scaled to `area`. Heights are `ue_height_m`, or at random between that and `highest_m`.

    `vip`: uniform over the area, but for the first 234 UEs, which draw the letters V, I and P (upright where
    x points right and y up). `uniform`: all at random. `grid`: a regular raster, filled along y first.
    """
    rng = np.random.default_rng([seed, _LAYOUT_STREAM])
    if name == "grid":
        ahead_along = _grid(ues)
    else:
        ahead_along = uniform(rng, (ues,))
        if name == "vip":
            drawn = min(ues, LETTER_UES)
            ahead_along[:drawn] = _letters(drawn)
    world = to_world(fitted(ahead_along, area), array, ue_height_m)
    if highest_m is not None:
        heights = np.random.default_rng([seed, _HEIGHT_STREAM])
        world[:, 2] = heights.uniform(ue_height_m, highest_m, ues)
    return world


def fitted(ahead_along: Floats, area: Area) -> Floats:
    """Points (..., 2) of `AREA_M` moved and stretched to `area`."""
    (low, high), (to_low, to_high) = np.transpose(AREA_M), np.transpose(area)
    moved: Floats = to_low + (ahead_along - low) * ((to_high - to_low) / (high - low))
    return moved


def uniform(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Points (*shape, 2) drawn uniformly over the area, in the array's horizontal frame."""
    low, high = np.transpose(AREA_M)
    return rng.uniform(low, high, (*shape, 2))


def to_world(ahead_along: NDArray[Any], array: ArrayGeometry, height_m: float) -> Floats:
    """World positions (..., 3) of points (..., 2) of the array's horizontal frame, at world height z."""
    ahead, along = _horizontal_frame(array)
    world: Floats = ahead_along[..., :1] * ahead + ahead_along[..., 1:] * along + np.asarray(array.position_m)
    world[..., 2] = height_m
    return world


def _horizontal_frame(array: ArrayGeometry) -> tuple[Floats, Floats]:
    """Horizontal unit vectors: ahead (broadside) and along (the axis, or across for an upright array)."""
    axis, broadside = np.array(array.axis), np.array(array.broadside)
    if np.hypot(axis[0], axis[1]) > 0.5:
        along = np.array([axis[0], axis[1], 0.0])
        along /= np.linalg.norm(along)
        ahead = np.array([along[1], -along[0], 0.0])
        return (ahead if ahead @ broadside >= 0 else -ahead), along
    ahead = np.array([broadside[0], broadside[1], 0.0])
    ahead /= np.linalg.norm(ahead)
    return ahead, np.array([-ahead[1], ahead[0], 0.0])


def _grid(ues: int) -> Floats:
    """A raster over the area with about equal steps both ways; the last row may stay short."""
    (x0, x1), (y0, y1) = AREA_M
    rows = max(1, round(np.sqrt(ues * (x1 - x0) / (y1 - y0))))
    columns = -(-ues // rows)
    index = np.arange(ues)
    x = x0 + (x1 - x0) * (index // columns + 0.5) / rows
    y = y0 + (y1 - y0) * (index % columns + 0.5) / columns
    return np.stack([x, y], axis=1)


def _letters(points: int) -> Floats:
    """Points (points, 2) at equal distances along the strokes of V, I and P, in that order."""
    h = _LETTER_HEIGHT_M
    bend = np.linspace(np.pi / 2, -np.pi / 2, 25)
    bowl = np.stack([490.0 + 0.25 * h * np.cos(bend), 0.75 * h + 0.25 * h * np.sin(bend)], axis=1)
    strokes = [
        np.array([[170.0, h], [235.0, 0.0], [300.0, h]]),
        np.array([[350.0, h], [350.0, 0.0]]),
        np.array([[410.0, 0.0], [410.0, h]]),
        np.array([[410.0, h], *bowl, [410.0, h / 2]]),
    ]
    lengths = np.array([_length(stroke)[-1] for stroke in strokes])
    ends = np.round(np.cumsum(lengths) / lengths.sum() * points).astype(int)
    counts = np.diff(ends, prepend=0)
    drawn = [_along(stroke, int(n)) for stroke, n in zip(strokes, counts, strict=True)]
    return np.concatenate(drawn) - [0.0, h / 2]


def _length(stroke: Floats) -> Floats:
    """Distance from the stroke's beginning to each of its corners."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(stroke, axis=0), axis=1))])


def _along(stroke: Floats, n: int) -> Floats:
    """n points at equal distances, half a step from either end of the stroke, so that none coincide."""
    reach = _length(stroke)
    at = reach[-1] * (np.arange(n) + 0.5) / n
    return np.stack([np.interp(at, reach, stroke[:, i]) for i in (0, 1)], axis=1)
