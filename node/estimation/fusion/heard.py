"""What one array has heard of UEs at known places, and how that fits a pose and an offset of its clock."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.site import Floats
from chachart.node.estimation.fusion.strongest import Paths

OFFSET = 6
"""Parameters of a pose: its middle (x, y, z), small turns about own axes, then the offset in metres ..."""
PARAMETERS = 7
"""... which makes so many."""
_STEP = 1e-5


@dataclass(frozen=True)
class Pose:
    """Where an array's middle is, its own axes as rows of `frame`, and by how much delays are too long."""

    middle: Floats
    frame: Floats
    offset_m: float = 0.0

    def moved(self, move: Floats) -> Self:
        """After small changes (7,): own axes turn about themselves."""
        turned = Rotation.from_rotvec(move[3:OFFSET]).as_matrix().T @ self.frame
        return type(self)(self.middle + move[:3], turned, self.offset_m + float(move[OFFSET]))

    def late(self, offset_m: float) -> Self:
        """With another offset."""
        return type(self)(self.middle, self.frame, offset_m)


@dataclass(frozen=True)
class Heard:
    """What one array has heard of UEs at known places.

    Attributes
    ----------
    array
        As it is described.
    paths
        Strongest paths of K frames.
    position
        World positions (K, 3) of the UEs.
    event
        Of which transmission (K,) each is.
    cell_m, unambiguous_m
        Resolution in range, and the range at which delays repeat.
    """

    array: ArrayGeometry
    paths: Paths
    position: Floats
    event: NDArray[np.intp]
    cell_m: float
    unambiguous_m: float

    @property
    def angles(self) -> int:
        """Angles a frame."""
        return int(self.paths.across.shape[1])

    @property
    def described(self) -> Pose:
        """The pose that the array should have."""
        return Pose(self.array.centre_m, self.array.frame)

    def some(self, which: NDArray[np.intp]) -> Self:
        """Only these frames."""
        paths, position, event = self.paths.some(which), self.position[which], self.event[which]
        return replace(self, paths=paths, position=position, event=event)

    def late(self, pose: Pose) -> Floats:
        """By how much (K,) each path is longer than the way."""
        way = np.linalg.norm(self.position - pose.middle, axis=1)
        return wrapped(self.paths.length_m - way, self.unambiguous_m)

    def typical(self, pose: Pose, which: NDArray[np.intp]) -> float:
        """The offset that most of these frames agree with."""
        return mode(self.late(pose)[which], self.unambiguous_m, self.cell_m)

    def off(self, pose: Pose) -> Floats:
        """By how much angles and lengths (K, A + 1) are other than the paths'."""
        own = (self.position - pose.middle) @ pose.frame.T
        way = np.linalg.norm(own, axis=1)
        unit = own / np.maximum(way, 1e-9)[:, None]
        if self.angles == 1:
            heard = self.paths.direction[:, 0]
            angles = (np.arcsin(np.clip(unit[:, 0], -1, 1)) - np.arcsin(np.clip(heard, -1, 1)))[:, None]
        else:
            across = np.einsum("kax,kx->ka", self.paths.across, unit)
            along = np.einsum("kx,kx->k", self.paths.direction, unit)
            sine = np.linalg.norm(across, axis=1)
            angle = np.arctan2(sine, along)
            angles = across * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[:, None]
        far = wrapped(way + pose.offset_m - self.paths.length_m, self.unambiguous_m)
        return np.column_stack([angles, far])

    def slopes(self, pose: Pose) -> Floats:
        """Derivatives (K, A + 1, 7) of `off` by the pose's parameters."""
        steps = _STEP * np.eye(PARAMETERS)
        both = [(self.off(pose.moved(step)), self.off(pose.moved(-step))) for step in steps]
        return np.stack([(plus - minus) / (2 * _STEP) for plus, minus in both], axis=2)


def wrapped(length: Floats, period: float) -> Floats:
    """Lengths from minus half a period to half a period."""
    found: Floats = (length + period / 2) % period - period / 2
    return found


def mode(values: Floats, period: float, width: float) -> float:
    """Where most of the values (K,), which repeat with `period`, are within `width` of each other."""
    apart = np.abs(wrapped(values[:, None] - values, period))
    centre = values[int(np.minimum(apart, width).sum(axis=1).argmin())]
    near = wrapped(values - centre, period)
    return float(wrapped(centre + np.median(near[np.abs(near) <= width]), period))
