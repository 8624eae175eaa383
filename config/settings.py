"""The sections of a node's configuration, but for sources and sinks: those keep their models beside them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from chachart.node.data.calibration import Calibration
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry, Vector
from chachart.node.data.settings import Means, Settings
from chachart.node.files.calibration import load_calibration

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class ArraySettings(Settings):
    """`[array]`: the antenna array and the subcarriers it measures."""

    name: Annotated[str, Means("of 1 to 64 letters, digits, - and _")] = Field(
        "lab", min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_-]+$"
    )
    """Which array; goes into topics (`chart.<name>`) and recordings."""
    antennas: int = Field(32, ge=1, le=1024)
    """N_R, elements of the uniform linear array."""
    carrier_hz: float = Field(2e9, gt=0)
    """Frequency of tone 0; tone k is at carrier_hz + k * subcarrier_spacing_hz."""
    subcarriers: int = Field(32, ge=1, le=16384)
    """N_S; need not be set beside tones."""
    subcarrier_spacing_hz: float = Field(9765.625, gt=0)
    """Distance between neighbouring tones."""
    tones: tuple[int, ...] | None = Field(None, examples=[(*range(-16, 0), *range(1, 17))])
    """Numbers of the subcarriers, ascending, where they are not 0, 1, 2 ... without a gap."""
    dead_antennas: tuple[int, ...] = Field((), examples=[(3,)])
    """Elements that do not count, by their place in the array: broken ones."""
    dead_tones: tuple[int, ...] = Field((), examples=[(0, 31)])
    """Subcarriers that do not count, by their place in the frames (0 ... subcarriers - 1)."""
    element_spacing_m: float | None = Field(None, gt=0)
    """Distance between neighbouring elements; half a wavelength where it is not set."""
    position_m: Vector = (0.0, 0.0, 10.0)
    """World position of element 0."""
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] | Vector = "y"
    """The direction in which element numbers grow; theta is measured from it."""
    broadside: Literal["x", "y", "z", "-x", "-y", "-z"] | Vector | None = None
    """The side that the chart shows; where not set, horizontal, right of the axis (x for axis y)."""
    height_m: float | None = Field(None, ge=0)
    """Height above the plane of the UEs; where set, slant ranges are projected to that plane."""
    light_speed_m_s: float = Field(SPEED_OF_LIGHT, gt=0)
    """Propagation speed; some published scenarios use 3e8."""
    antenna_order: tuple[int, ...] | None = Field(None, examples=[(1, 0)])
    """For each element in turn, the number that its antenna has in the frames; not set: the same."""
    calibration: Path | None = None
    """A file of `chachart calibrate`, undone in every frame; it has an antenna order of its own."""

    @field_validator("axis", "broadside")
    @classmethod
    def _unit(cls, value: Any) -> Any:
        if isinstance(value, tuple):
            length = float(np.linalg.norm(value))
            if length == 0:
                raise ValueError("must not be the zero vector")
            return tuple(v / length for v in value)
        return value

    def geometry(self) -> ArrayGeometry:
        """The array as the estimators see it.

        Raises
        ------
        ValueError
            If axis and broadside are not orthogonal, or tones or what is dead do not fit.
        """
        axis = _vector(self.axis)
        if self.broadside is not None:
            broadside = _vector(self.broadside)
        elif abs(axis[2]) > 0.999:
            broadside = (1.0, 0.0, 0.0)
        else:
            side = np.array([axis[1], -axis[0], 0.0])
            broadside = _tuple(side / np.linalg.norm(side))
        return ArrayGeometry(
            name=self.name,
            antennas=self.antennas,
            subcarriers=self._subcarriers(),
            carrier_hz=self.carrier_hz,
            subcarrier_spacing_hz=self.subcarrier_spacing_hz,
            element_spacing_m=self.element_spacing_m or self.light_speed_m_s / self.carrier_hz / 2,
            position_m=self.position_m,
            axis=axis,
            broadside=broadside,
            height_m=self.height_m,
            light_speed_m_s=self.light_speed_m_s,
            tones=self.tones,
            dead_antennas=tuple(sorted(set(self.dead_antennas))),
            dead_tones=tuple(sorted(set(self.dead_tones))),
        )

    def _subcarriers(self) -> int:
        """As many as there are tones, where only those are said."""
        if self.tones is None or "subcarriers" in self.model_fields_set:
            return self.subcarriers
        return len(self.tones)

    def correction(self) -> Calibration | None:
        """What `antenna_order` or the calibration file says; None where neither is set.

        Raises
        ------
        ValueError
            If both are set, or the file cannot be read.
        """
        if self.calibration is None:
            if self.antenna_order is None:
                return None
            return Calibration.order_only(self.antenna_order, self._subcarriers())
        if self.antenna_order is not None:
            raise ValueError("antenna_order cannot be set beside calibration, which has one of its own")
        return load_calibration(self.calibration)


class WorkersSettings(Settings):
    """`[workers]`: the processes that estimate."""

    count: int = Field(1, ge=1, le=64)
    """Worker processes; a UE belongs to one of them for good."""
    block_frames: int = Field(64, ge=1, le=4096)
    """A block goes to its worker when it holds so many frames ..."""
    linger_ms: float = Field(5.0, ge=0, le=1000)
    """... or when its first frame has waited so long."""
    queue_blocks: int = Field(64, ge=1, le=65536)
    """Blocks that may wait for a worker before a lossless source waits and a live one drops its oldest."""
    credit_blocks: int = Field(8, ge=1, le=1024)
    """Blocks that a worker may hold unacknowledged."""


class QualitySettings(Settings):
    """`[quality]`: how good the chart is, where reference positions are known."""

    every_s: float = Field(5.0, gt=0)
    """How often quality is computed while the node runs."""
    k: int | None = Field(None, ge=1)
    """Neighbours for TW and CT; where not set, 5 % of the UEs with a known position, at least 5."""
    exact_ues: int = Field(4096, ge=4)
    """Up to so many UEs TW and CT are exact; beyond, they are sampled and carry a standard error."""


def _vector(value: str | Vector) -> Vector:
    if isinstance(value, tuple):
        return value
    sign = -1.0 if value.startswith("-") else 1.0
    return _tuple(sign * np.array(_AXES[value[-1]]))


def _tuple(values: Any) -> Vector:
    x, y, z = (float(v) + 0.0 for v in values)
    return (x, y, z)
