"""Where an array's elements are in the world, and where what it sees is: the geometry of `ArrayGeometry`."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from chachart.node.data import elements as layouts
from chachart.node.data.places import placed

Vector = tuple[float, float, float]
FloatArray = NDArray[np.float64]
Sees = Literal["front", "below", "above", "all"]


class Pose:
    """Directions, places and chart coordinates of an array that is described by these fields."""

    __slots__ = ()

    antennas: int
    carrier_hz: float
    element_spacing_m: float
    position_m: Vector
    axis: Vector
    broadside: Vector
    height_m: float | None
    light_speed_m_s: float
    elements: tuple[Vector, ...] | None
    sees: Sees | None

    @property
    def wavelength_m(self) -> float:
        """Wavelength at the carrier."""
        return self.light_speed_m_s / self.carrier_hz

    @property
    def is_line(self) -> bool:
        """Whether all elements are on one line along `axis`: it knows theta alone."""
        return self.elements is None or layouts.on_one_line(self.own_elements)

    @property
    def is_uniform(self) -> bool:
        """Whether it is a line of even steps along `axis`, numbered that way."""
        return self.elements is None

    @property
    def right(self) -> FloatArray:
        """Unit vector (3,) to the right of somebody in front of the array: `axis`."""
        return np.asarray(self.axis, np.float64)

    @property
    def normal(self) -> FloatArray:
        """Unit vector (3,) out of the array, to the side that it looks to: `broadside`."""
        return np.asarray(self.broadside, np.float64)

    @property
    def up(self) -> FloatArray:
        """Unit vector (3,) upwards, for the same person."""
        return np.asarray(np.cross(self.normal, self.right))

    @property
    def frame(self) -> FloatArray:
        """(3, 3), its rows right, up and normal: own = frame @ world, world = own @ frame."""
        return np.stack([self.right, self.up, self.normal])

    @property
    def own_elements(self) -> FloatArray:
        """Elements (antennas, 3) along (right, up, normal) from their middle."""
        if self.elements is None:
            return layouts.line(self.antennas, self.element_spacing_m)
        places = np.asarray(self.elements, np.float64)
        centred: FloatArray = places - places.mean(axis=0)
        return centred

    @property
    def facing(self) -> FloatArray | None:
        """Own unit vector (3,) into the half of all directions where UEs are looked for; None for all.

        A line has none: its cone is charted on the broadside.
        """
        towards = {"front": (0.0, 0.0, 1.0), "below": (0.0, -1.0, 0.0), "above": (0.0, 1.0, 0.0)}
        if self.sees is not None:
            return None if self.sees == "all" else np.array(towards[self.sees])
        plane = None if self.elements is None else layouts.mirror(self.own_elements)
        if plane is None:
            return None
        return -plane if abs(plane[1]) > 1 - 1e-6 else plane

    def element_positions(self) -> FloatArray:
        """World positions of the elements, (antennas, 3) in metres."""
        if self.elements is not None:
            return (
                np.asarray(self.position_m, np.float64) + np.asarray(self.elements, np.float64) @ self.frame
            )
        steps = np.arange(self.antennas, dtype=np.float64)[:, None] * self.element_spacing_m
        return np.asarray(self.position_m, np.float64) + steps * np.asarray(self.axis, np.float64)

    @property
    def centre_m(self) -> FloatArray:
        """World position (3,) of the middle of the array, the origin of a line's chart."""
        middle: FloatArray = self.element_positions().mean(axis=0)
        return middle

    def theta_rho(self, position: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """True cone angle (rad) and slant range (m) of world positions (..., 3), from the array's middle."""
        offset = np.asarray(position, np.float64) - self.centre_m
        rho: FloatArray = np.linalg.norm(offset, axis=-1)
        cosine = np.divide(offset @ np.asarray(self.axis), rho, out=np.zeros_like(rho), where=rho > 0)
        return np.arccos(np.clip(cosine, -1.0, 1.0)), rho

    def towards(self, position: NDArray[Any]) -> FloatArray:
        """Own unit vectors (..., 3) along (right, up, normal) from the middle to world positions."""
        offset = (np.asarray(position, np.float64) - self.centre_m) @ self.frame.T
        size = np.linalg.norm(offset, axis=-1, keepdims=True)
        unit: FloatArray = np.divide(offset, size, out=np.zeros_like(offset), where=size > 0)
        return unit

    def world_of(self, direction: NDArray[Any], rho: NDArray[Any]) -> FloatArray:
        """World positions (..., 3) in own directions (..., 3), unit vectors, at slant ranges rho (...).

        Where `height_m` is set they are in the plane of the UEs, see `placed`.
        """
        world = np.asarray(direction, np.float64) @ self.frame
        return placed(self.centre_m, world, np.asarray(rho, np.float64), self.height_m)

    def chart_xy(self, theta: NDArray[Any], rho: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """A line's chart coordinates (m) of cone angles (rad) and slant ranges (m).

        Where `height_m` is set, the slant range is projected to the plane of the UEs; a range too short to
        reach the plane lands on x = 0.
        """
        theta, rho = np.asarray(theta, np.float64), np.asarray(rho, np.float64)
        x, y = rho * np.sin(theta), rho * np.cos(theta)
        if self.height_m is not None:
            x = np.sqrt(np.maximum(x * x - self.height_m**2, 0.0))
        return x, y

    def chart_of(self, position: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """Chart coordinates (m) of world positions (..., 3).

        A line's x is along broadside and y along the axis; other arrays are charted in world metres.
        """
        if not self.is_line:
            world = np.asarray(position, np.float64)
            return world[..., 0], world[..., 1]
        offset = np.asarray(position, np.float64) - self.centre_m
        return offset @ np.asarray(self.broadside), offset @ np.asarray(self.axis)
