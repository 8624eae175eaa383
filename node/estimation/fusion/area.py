"""Where UEs can be: a plane, a polygon on it, or a box, and the coarse grid that a search begins with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.fusion.site import Floats, Site

CELLS_A_STEP = 1 / 3
"""Coarse steps are a third of a range cell, ..."""
STEPS_ACROSS = 40
"""... and at most a fortieth of the area's shorter side, since a beam is narrow near its array, ..."""
MOST_POINTS = 12_000
"""... but no more points than this are searched."""
OUTSIDE = 0.5
"""An area that is not given reaches this part of the arrays' extent beyond them, at least `LEAST_M`."""
LEAST_M = 10.0
FARTHEST_M = 1000.0
"""Round one array alone, it reaches as far as delays are unambiguous, at most so far."""


@dataclass(frozen=True)
class Area:
    """Where UEs can be.

    Parameters
    ----------
    low, high
        Corners (x, y) in world metres.
    height_m
        z of the UEs; with `slope` that at x = y = 0; None: anywhere within `heights_m`.
    slope
        dz/dx and dz/dy of the plane that UEs are on.
    heights_m
        Lowest and highest z where `height_m` is None.
    outline
        Polygon (K, 2) that UEs are inside; None: the whole rectangle.

    Raises
    ------
    ValueError
        If corners are not in order, or an outline has fewer than three.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    height_m: float | None = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    heights_m: tuple[float, float] = (0.0, 3.0)
    outline: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise ValueError(
                f"the area must reach from a lower to a higher corner, not {self.low} to {self.high}"
            )
        if self.outline is not None and len(self.outline) < 3:
            raise ValueError(f"an outline needs at least 3 corners, not {len(self.outline)}")
        if self.height_m is None and not self.heights_m[0] < self.heights_m[1]:
            raise ValueError(f"heights_m must be a lower and a higher z, not {self.heights_m}")

    @classmethod
    def around(cls, sites: Sequence[Site], height_m: float | None) -> Area:
        """The rectangle of the arrays and half as much again, where nobody says where UEs are."""
        centres = np.array([site.centre[:2] for site in sites])
        low, high = centres.min(axis=0), centres.max(axis=0)
        beyond = max(OUTSIDE * float((high - low).max()), LEAST_M)
        if len(sites) == 1:
            beyond = min(sites[0].unambiguous_m, FARTHEST_M)
        a, b = low - beyond, high + beyond
        return cls((float(a[0]), float(a[1])), (float(b[0]), float(b[1])), height_m)

    @property
    def freedoms(self) -> int:
        """Coordinates that are searched: x and y, and z where it is free."""
        return 2 if self.height_m is not None else 3

    @property
    def basis(self) -> Floats:
        """What a step in each coordinate does to a world position, (freedoms, 3)."""
        if self.height_m is None:
            return np.eye(3)
        return np.array([[1.0, 0.0, self.slope[0]], [0.0, 1.0, self.slope[1]]])

    def grid(self, sites: Sequence[Site]) -> Grid:
        """The coarse points for arrays like `sites`."""
        sides = np.subtract(self.high, self.low)
        step = min(min(site.cell_m for site in sites) * CELLS_A_STEP, float(sides.min()) / STEPS_ACROSS)
        levels = 1
        if self.height_m is None:
            levels = max(2, int(np.ceil((self.heights_m[1] - self.heights_m[0]) / max(2 * step, 0.5))) + 1)
        step = max(step, float(np.sqrt(sides.prod() * levels / MOST_POINTS)))
        axes = [
            np.linspace(a, b, max(2, round((b - a) / step) + 1))
            for a, b in zip(self.low, self.high, strict=True)
        ]
        x, y = np.meshgrid(*axes, indexing="ij")
        if self.height_m is None:
            z = np.linspace(*self.heights_m, levels)
            shape = (*x.shape, levels)
            parts = [np.broadcast_to(v[..., None], shape) for v in (x, y)] + [np.broadcast_to(z, shape)]
        else:
            shape = x.shape
            parts = [x, y, self.height(np.stack([x, y], axis=-1))]
        points = np.stack(parts, axis=-1).reshape(-1, 3)
        return Grid(points, shape, step, self.contains(points))

    def height(self, place: Floats) -> Floats:
        """z (...) at places (..., 2); in the middle where it is free."""
        if self.height_m is None:
            return np.full(place.shape[:-1], sum(self.heights_m) / 2)
        heights: Floats = self.height_m + place @ np.asarray(self.slope)
        return heights

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Whether world positions (..., 3) are inside the area."""
        x, y = points[..., 0], points[..., 1]
        inside: NDArray[np.bool_] = (
            (x >= self.low[0]) & (x <= self.high[0]) & (y >= self.low[1]) & (y <= self.high[1])
        )
        if self.height_m is None:
            inside &= (points[..., 2] >= self.heights_m[0]) & (points[..., 2] <= self.heights_m[1])
        if self.outline is None:
            return inside
        odd = np.zeros(x.shape, np.bool_)
        corners = np.asarray(self.outline, np.float64)
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if y0 != y1:
                odd ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
        return inside & odd


@dataclass(frozen=True)
class Grid:
    """Coarse points (G, 3) in the order of an array of `shape`, their distance, and which are in the area."""

    points: Floats
    shape: tuple[int, ...]
    step: float
    inside: NDArray[np.bool_]
