"""The sections of a node's configuration, but for sources and sinks: those keep their models beside them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from chachart.node.data.calibration import Calibration
from chachart.node.data.elements import circle, grid
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry, ClockShares
from chachart.node.data.pose import Sees, Vector
from chachart.node.data.settings import Means, Settings
from chachart.node.files.array_files import ArrayFile, read_array_file
from chachart.node.files.calibration import load_calibration

TIME_TOLERANCE_S = 60.0
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SHAPES = ("rows", "columns", "radius_m", "elements", "file")
Direction = Literal["x", "y", "z", "-x", "-y", "-z"] | Vector


class ArraySettings(Settings):
    """`[array]`: the antenna array and the subcarriers it measures."""

    name: Annotated[str, Means("of 1 to 64 letters, digits, - and _")] = Field(
        "lab", min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_-]+$"
    )
    """Which array; goes into topics (`chart.<name>`) and recordings."""
    antennas: int = Field(32, ge=1, le=1024)
    """N_R, elements of a uniform line or a circle; a board or list of elements says it itself."""
    rows: int | None = Field(None, ge=1, le=1024)
    """With columns: a board. Element row * columns + column, row 0 on top, column 0 on the left."""
    columns: int | None = Field(None, ge=1, le=1024)
    """With rows: a board."""
    row_spacing_m: float | None = Field(None, gt=0)
    """Distance between the rows of a board; not set: that between its columns, element_spacing_m."""
    radius_m: float | None = Field(None, gt=0)
    """A circle of `antennas`: element 0 towards broadside, the next ones turning to axis."""
    elements: tuple[Vector, ...] | None = Field(None, examples=[((0.0, 0.05, 0.0), (0.05, 0.0, 0.0))])
    """Elements one by one: metres along (axis, up, broadside) from position_m."""
    file: Path | None = None
    """A file with the elements: .csv (right,up,normal), spec.json, pyespargos .yml, or QuaDRiGa's .qdant."""
    file_array: int | None = Field(None, ge=0)
    """Which of the arrays in `file`."""
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
    """Distance between neighbouring elements; not set: half the wavelength of the highest subcarrier."""
    position_m: Vector = (0.0, 0.0, 10.0)
    """World position of a line's element 0, of the middle of a board or circle, of the origin of elements."""
    axis: Direction = "y"
    """The way a line's or row's numbers grow, right as seen from in front; theta is measured from it."""
    broadside: Direction | None = None
    """The side that the array looks to; where not set, as `up` has it, or horizontal (x for axis y)."""
    up: Direction | None = None
    """Upwards as seen from in front, instead of broadside = axis x up."""
    sees: Sees | None = None
    """Where UEs are looked for; not set: a board's front, below a horizontal array, everywhere for others."""
    clock: str | None = Field(None, min_length=1, max_length=64)
    """Name of the clock that the array runs by; arrays that share it say the same. Not set: its own."""
    clock_shares: ClockShares = "time"
    """What arrays by one clock share: the time of arrival, or only the frequency."""
    height_m: float | None = Field(None, ge=0)
    """Height above the plane of the UEs; where set, slant ranges are projected to that plane."""
    light_speed_m_s: float = Field(SPEED_OF_LIGHT, gt=0)
    """Propagation speed; some published scenarios use 3e8."""
    antenna_order: tuple[int, ...] | None = Field(None, examples=[(1, 0)])
    """For each element in turn, the number that its antenna has in the frames; not set: the same."""
    time_tolerance_s: float = Field(TIME_TOLERANCE_S, gt=0)
    """A live frame whose time is further from this host's gets the host's, and counts as `restamped`."""
    calibration: Path | None = None
    """A file of `chachart calibrate`, undone in every frame; it has an antenna order of its own."""

    @field_validator("axis", "broadside", "up")
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
            If axis and broadside are not orthogonal, keys do not go together, a file cannot be used, or tones
            or what is dead do not fit.
        """
        described = self._described()
        axis, broadside = self._pose(described)
        light = self.light_speed_m_s
        pose: dict[str, Any] = {
            "axis": axis,
            "broadside": broadside,
            "height_m": self.height_m,
            "light_speed_m_s": light,
            "sees": self.sees,
            "clock": self.clock,
            "clock_shares": self.clock_shares,
            "tones": self.tones,
            "dead_antennas": tuple(sorted(set(self.dead_antennas))),
            "dead_tones": tuple(sorted(set(self.dead_tones))),
        }
        band = (self._subcarriers(), self.carrier_hz, self.subcarrier_spacing_hz)
        position = self.position_m
        if described is None:
            spacing = self.element_spacing_m or self._half_wave()
            return ArrayGeometry(self.name, self.antennas, *band, spacing, position, **pose)
        pose["pattern"] = described.pattern
        if described.position_m is not None and "position_m" not in self.model_fields_set:
            position = described.position_m
        return ArrayGeometry.of_elements(self.name, described.elements, *band, position_m=position, **pose)

    def _described(self) -> ArrayFile | None:
        """The elements, where they are no uniform line."""
        given = [name for name in _SHAPES if getattr(self, name) is not None]
        if not given:
            return None
        if len(given) > 1 and given != ["rows", "columns"]:
            raise ValueError(f"{' and '.join(given)} cannot both be set: each is another shape")
        if self.radius_m is not None:
            return ArrayFile(circle(self.antennas, self.radius_m))
        if self.file is not None:
            found = read_array_file(self.file, self.file_array, self.element_spacing_m)
        elif self.elements is not None:
            found = ArrayFile(np.array(self.elements, np.float64).reshape(-1, 3))
        else:
            spacing = self.element_spacing_m or self._half_wave()
            found = ArrayFile(grid(self.rows or 1, self.columns or 1, spacing, self.row_spacing_m))
        if "antennas" in self.model_fields_set and self.antennas != len(found.elements):
            shape = " and ".join(given)
            raise ValueError(
                f"antennas = {self.antennas}, but {shape} make {len(found.elements)}: leave it out"
            )
        return found

    def _pose(self, described: ArrayFile | None) -> tuple[Vector, Vector]:
        """Axis and broadside: as they are set, or else as the file has them."""
        axis, up = _vector(self.axis), None if self.up is None else _vector(self.up)
        if described is not None and described.right is not None and "axis" not in self.model_fields_set:
            axis = described.right
            up = described.up if self.up is None else up
        if self.broadside is not None:
            if self.up is not None:
                raise ValueError("broadside and up cannot both be set: one follows from the other")
            return axis, _vector(self.broadside)
        if up is not None:
            if abs(float(np.dot(axis, up))) > 1e-3:
                raise ValueError(f"up {up} must be orthogonal to axis {axis}")
            normal = np.cross(axis, up)
            return axis, _tuple(normal / np.linalg.norm(normal))
        if abs(axis[2]) > 0.999:
            return axis, (1.0, 0.0, 0.0)
        side = np.array([axis[1], -axis[0], 0.0])
        return axis, _tuple(side / np.linalg.norm(side))

    def _half_wave(self) -> float:
        """Half the shortest wavelength: up to it no direction passes for another, in any subcarrier."""
        highest = self._subcarriers() - 1 if self.tones is None else max(self.tones, default=0)
        return self.light_speed_m_s / (self.carrier_hz + highest * self.subcarrier_spacing_hz) / 2

    def _subcarriers(self) -> int:
        """As many as there are tones, where only those are said."""
        if self.tones is None or "subcarriers" in self.model_fields_set:
            return self.subcarriers
        return len(self.tones)

    def correction(self) -> Calibration | None:
        """What `antenna_order`, the calibration file or `file` says; None where none is set.

        Raises
        ------
        ValueError
            If both are set, or the file cannot be read.
        """
        if self.calibration is None:
            order = self.antenna_order
            if order is None and self.file is not None:
                order = read_array_file(self.file, self.file_array, self.element_spacing_m).channels
            if order is None:
                return None
            return Calibration.order_only(order, self._subcarriers())
        if self.antenna_order is not None:
            raise ValueError("antenna_order cannot be set beside calibration, which has one of its own")
        return load_calibration(self.calibration)


class WorkersSettings(Settings):
    """`[workers]`: the processes that estimate."""

    count: int = Field(1, ge=1, le=64)
    """Worker processes; a UE belongs to one of them for good."""
    block_frames: int = Field(64, ge=1, le=4096)
    """What comes while a worker is busy grows to blocks of so many frames; an idle one gets it at once."""
    linger_ms: float = Field(1.0, ge=0, le=1000)
    """The longest that a block waits to grow."""
    queue_blocks: int = Field(64, ge=1, le=65536)
    """Blocks that may wait for a worker before a lossless source waits and a live one drops its oldest."""
    credit_blocks: int = Field(8, ge=1, le=1024)
    """Blocks that a worker may hold unacknowledged."""
    runtime: Literal["processes", "ray"] = "processes"
    """Where workers run: on this machine, or where Ray puts them (pip install "chachart[ray]")."""
    address: str | None = Field(None, min_length=1, examples=["auto", "10.0.0.1:6379"])
    """The Ray cluster's; `auto`: the one that this machine is part of. Not set: one of this machine alone."""
    resources: dict[str, Annotated[float, Field(gt=0)]] = Field(
        default_factory=lambda: {"CPU": 1.0}, examples=[{"CPU": 1.0, "rack_2": 1.0}]
    )
    """What each worker asks of Ray: names of resources, and how much."""


class QualitySettings(Settings):
    """`[quality]`: how good the chart is, where reference positions are known."""

    every_s: float = Field(5.0, gt=0)
    """How often quality is computed while the node runs."""
    k: int | None = Field(None, ge=1)
    """Neighbours for TW and CT; where not set, 5 % of the UEs with a known position, at least 5."""
    exact_ues: int = Field(4096, ge=4)
    """Up to so many UEs TW and CT are exact; beyond, they are sampled and carry a standard error."""


class StateSettings(Settings):
    """`[state]`: what has been learnt, kept for whoever goes on after a process or the machine died."""

    directory: Annotated[str, Means("that is a folder's path, or a URL of one")] | None = Field(
        None, min_length=1, examples=["/var/lib/chachart", "s3://bucket/chachart"]
    )
    """Where snapshots go that `chachart-node --resume` goes on from; not set: they go with the node."""
    every_s: float = Field(10.0, ge=0)
    """How often each worker writes a snapshot; 0: never, and what a dead worker had learnt is lost."""
    retain_mib: float = Field(256.0, ge=1)
    """CSI since the last snapshots that is held in memory for the successor of a worker that dies."""
    resume: bool = False
    """Go on from the newest snapshots in `directory`, as --resume does."""


def _vector(value: str | Vector) -> Vector:
    if isinstance(value, tuple):
        return value
    sign = -1.0 if value.startswith("-") else 1.0
    return _tuple(sign * np.array(_AXES[value[-1]]))


def _tuple(values: Any) -> Vector:
    x, y, z = (float(v) + 0.0 for v in values)
    return (x, y, z)
