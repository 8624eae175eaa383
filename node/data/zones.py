"""Zones of the chart: named areas that UEs enter and leave."""

from __future__ import annotations

from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from chachart.node.data.settings import Means, Settings

MOST_CORNERS = 4096
ROUND_CORNERS = 48
Corner = tuple[float, float]
Name = Annotated[str, Means("of 1 to 64 letters"), Field(min_length=1, max_length=64)]


class ZoneSettings(Settings):
    """`[[zones]]`: an area of the chart, which the page shows and alerts name."""

    name: Name
    """What it is called."""
    polygon: Annotated[tuple[Corner, ...], Field(min_length=3, max_length=MOST_CORNERS)] | None = Field(
        None, examples=[((0.0, 0.0), (20.0, 0.0), (20.0, 12.0))]
    )
    """Its corners, x and y on the chart in metres."""
    circle: tuple[float, float, Annotated[float, Field(gt=0)]] | None = Field(
        None, examples=[(10.0, 5.0, 3.0)]
    )
    """x and y of its middle, and its radius, instead of corners."""

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if (self.polygon is None) == (self.circle is None):
            raise ValueError("one of polygon and circle must be set")
        if self.polygon is not None and not enclosed_m2(np.array(self.polygon)) > 0:
            raise ValueError("polygon encloses nothing")
        return self

    def contains(self, x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.bool_]:
        """Which of the places (N,), in chart metres, are inside; unknown ones are not."""
        if self.circle is not None:
            cx, cy, radius = self.circle
            return np.asarray(np.hypot(x - cx, y - cy) <= radius)
        return inside(self.outline(), x, y)

    def outline(self) -> NDArray[np.float64]:
        """Its corners (M, 2); of a circle those of a polygon that looks like one."""
        if self.polygon is not None:
            return np.array(self.polygon)
        assert self.circle is not None
        x, y, radius = self.circle
        angle = np.linspace(0, 2 * np.pi, ROUND_CORNERS, endpoint=False)
        return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)])


def inside(corners: NDArray[np.float64], x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.bool_]:
    """Which of the points (N,) are inside a polygon (M, 2): an odd number of edges is to their right."""
    odd = np.zeros(len(x), np.bool_)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (y0 > y) != (y1 > y)
        if crosses.any():
            with np.errstate(divide="ignore", invalid="ignore"):
                odd ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return odd


def enclosed_m2(corners: NDArray[np.float64]) -> float:
    """The area of a polygon (M, 2)."""
    x, y = corners.T
    return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2
