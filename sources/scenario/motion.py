"""How UEs move: position as a pure function of UE and time, for any number of UEs at once."""

from __future__ import annotations

from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.scenario.layout import AREA_M, Area, fitted, to_world, uniform

Floats = NDArray[np.float64]
MotionName = Literal["static", "waypoint"]

_MOTION_STREAM = 2


class Motion(Protocol):
    """Where which UE is at what time."""

    def at(self, ue: NDArray[Any], time_s: NDArray[Any]) -> Floats:
        """World positions (K, 3) of the UEs `ue` (indices, K) at `time_s` (K,) seconds after the start."""


class Static:
    """UEs that stay where they were put, `start` (U, 3)."""

    def __init__(self, start: Floats) -> None:
        self.start = start

    def at(self, ue: NDArray[Any], time_s: NDArray[Any]) -> Floats:
        """World positions (K, 3); time does not matter."""
        still: Floats = self.start[ue]
        return still


class RandomWaypoint:
    """Each UE walks in a straight line to a point drawn uniformly over the layout's area, then to the next.

    All walk at `speed_m_s`, without pauses. A UE's points are drawn beforehand, and after the last of them it
    returns to where it began and walks the same round again: that makes the position a pure function of
    time, the same however the frames are cut into blocks. As with every random waypoint model, UEs come to be
    denser in the middle of the area than they were at the start.

    Parameters
    ----------
    start
        (U, 3) world positions at time 0.
    array
        The array before which the area lies.
    speed_m_s
        Walking speed.
    seed
        Same seed, same walks.
    legs
        Straight lines before a walk repeats.
    area
        Where, ahead of the array and along it.
    """

    def __init__(
        self,
        start: Floats,
        array: ArrayGeometry,
        speed_m_s: float,
        seed: int = 0,
        legs: int = 24,
        area: Area = AREA_M,
    ) -> None:
        rng = np.random.default_rng([seed, _MOTION_STREAM])
        ues = len(start)
        corners = to_world(fitted(uniform(rng, (ues, legs - 1)), area), array, 0.0)
        corners[..., 2] = start[:, None, 2]
        self._corners = np.concatenate([start[:, None], corners, start[:, None]], axis=1)
        steps = np.linalg.norm(np.diff(self._corners, axis=1), axis=2)
        self._reach = np.concatenate([np.zeros((ues, 1)), np.cumsum(steps, axis=1)], axis=1)
        self._speed = speed_m_s

    def at(self, ue: NDArray[Any], time_s: NDArray[Any]) -> Floats:
        """World positions (K, 3) of the UEs `ue` (K,) at `time_s` (K,)."""
        reach = self._reach[ue]
        walked = (self._speed * np.asarray(time_s, np.float64)) % reach[:, -1]
        leg = np.sum(reach[:, 1:-1] <= walked[:, None], axis=1)
        row = np.arange(len(leg))
        begin, end = reach[row, leg], reach[row, leg + 1]
        part = ((walked - begin) / (end - begin))[:, None]
        corner = self._corners[ue, leg]
        moved: Floats = corner + part * (self._corners[ue, leg + 1] - corner)
        return moved
