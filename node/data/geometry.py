"""Where an array is and which way it looks: world positions, directions, ranges and chart coordinates.

An array has a pose: `position_m`, `axis` and `broadside`. Seen by somebody in front of it, axis points to the
right, broadside towards this person, and `up = broadside x axis`. Element n of a uniform line sits at
`position_m + n * element_spacing_m * axis`; any other array has `elements`, positions along (axis, up,
broadside) from `position_m`.

Directions are seen from the middle of the array, which is what all elements together measure from: azimuth =
atan2(d.axis, d.broadside), elevation = asin(d.up), theta the cone angle to `axis` in 0..pi, and rho the slant
range. A line knows theta alone: its chart has y along the axis and x along broadside, `x = rho sin(theta)`,
`y = rho cos(theta)`, on the broadside of the two sides that it cannot tell apart. Any other array's chart
is in world metres.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from chachart.node.data import elements as layouts
from chachart.node.data.calibration import Calibration
from chachart.node.data.pattern import Pattern
from chachart.node.data.pose import Pose, Sees, Vector

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum, m/s."""

MOST_TONE = 1 << 20
"""Largest number of a tone, either way."""

FloatArray = NDArray[np.float64]
ClockShares = Literal["time", "frequency"]
SEES, CLOCK_SHARES = (None, *get_args(Sees)), get_args(ClockShares)

_LATER: Final = (
    "tones",
    "dead_antennas",
    "dead_tones",
    "elements",
    "sees",
    "clock",
    "clock_shares",
    "pattern",
)
"""Fields that a description goes without while they are at their defaults, as those of old recordings do."""


@dataclass(frozen=True, slots=True)
class ArrayGeometry(Pose):
    """An antenna array, where it is, and the subcarriers it measures; a uniform line if it has no `elements`.

    The subcarriers need not be even: `tones` numbers them in steps of `subcarrier_spacing_hz`.

    Parameters
    ----------
    name
        Which array; goes into topics and recordings.
    antennas, subcarriers
        N_R and N_S.
    carrier_hz, subcarrier_spacing_hz
        Subcarrier n is at `carrier_hz + tone_numbers[n] * subcarrier_spacing_hz`.
    element_spacing_m
        Distance d between neighbouring elements; with `elements`, the least between any two.
    position_m
        World position of a line's element 0, or of the origin of `elements`.
    axis, broadside
        Orthogonal unit vectors: the line of the elements (right), the side that the array looks to (normal).
    height_m
        Height of the array above the plane of the UEs; None leaves the slant range unprojected.
    light_speed_m_s
        Propagation speed; some published scenarios round it to 3e8.
    calibration
        Order and response of the antennas; the estimators undo it. None: the frames are as they should be.
    tones
        Numbers of the subcarriers, ascending; None stands for 0 ... N_S - 1.
    dead_antennas, dead_tones
        Elements, and indices of subcarriers, that do not count, ascending. Frames still have them.
    elements
        Where they are along (right, up, normal), metres; None for a uniform line.
    sees
        Where UEs are looked for: "front" (d.normal > 0), "below", "above" (d.up) or "all"; None as the shape
        has it: a board sees what is in front, a horizontal array what is below, others see all.
    clock, clock_shares
        Name of the clock that the array runs by, None for one of its own; arrays by one clock share time, or
        only frequency.
    pattern
        Gains of the elements over directions; None: they are all alike.

    Raises
    ------
    ValueError
        If a number is out of range, or axis and broadside are not orthogonal unit vectors.
    """

    name: str
    antennas: int
    subcarriers: int
    carrier_hz: float
    subcarrier_spacing_hz: float
    element_spacing_m: float
    position_m: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 1.0, 0.0)
    broadside: Vector = (1.0, 0.0, 0.0)
    height_m: float | None = None
    light_speed_m_s: float = SPEED_OF_LIGHT
    calibration: Calibration | None = None
    tones: tuple[int, ...] | None = None
    dead_antennas: tuple[int, ...] = ()
    dead_tones: tuple[int, ...] = ()
    elements: tuple[Vector, ...] | None = None
    sees: Sees | None = None
    clock: str | None = None
    clock_shares: ClockShares = "time"
    pattern: Pattern | None = None

    def __post_init__(self) -> None:
        if type(self.name) is not str or not self.name:
            raise ValueError(f"name must be a text, not {self.name!r}")
        for name in ("antennas", "subcarriers"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 1:
                raise ValueError(f"{name} must be a positive whole number, not {value!r}")
        for name in ("carrier_hz", "subcarrier_spacing_hz", "element_spacing_m", "light_speed_m_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if self.height_m is not None and not 0 <= self.height_m < np.inf:
            raise ValueError(f"height_m must be at least 0, not {self.height_m}")
        position = np.asarray(self.position_m, np.float64)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise ValueError(f"position_m must be 3 numbers, not {self.position_m}")
        axis, broadside = np.asarray(self.axis), np.asarray(self.broadside)
        for name, v in (("axis", axis), ("broadside", broadside)):
            if v.shape != (3,) or not abs(math.hypot(*v) - 1.0) <= 1e-5:
                raise ValueError(f"{name} must be a unit vector of 3 numbers, not {getattr(self, name)}")
        if abs(float(axis @ broadside)) > 1e-6:
            raise ValueError(f"broadside {self.broadside} must be orthogonal to axis {self.axis}")
        self._check_numbers()
        self._check_elements()
        c = self.calibration
        if c is not None and (c.antennas, c.subcarriers) != (self.antennas, self.subcarriers):
            raise ValueError(
                f"the calibration is of {c.antennas} antennas and {c.subcarriers} subcarriers, "
                f"the array has {self.antennas} and {self.subcarriers}"
            )

    def _check_numbers(self) -> None:
        """`tones` and what is dead, each as a tuple of ints in ascending order."""
        if self.tones is not None:
            object.__setattr__(self, "tones", _ascending("tones", self.tones))
            if len(self.tones) != self.subcarriers:
                raise ValueError(
                    f"tones must number all {self.subcarriers} subcarriers, not {len(self.tones)}"
                )
            if max(abs(self.tones[0]), abs(self.tones[-1])) > MOST_TONE:
                raise ValueError(f"tones must lie within -{MOST_TONE} and {MOST_TONE}, not {self.tones}")
            if self.carrier_hz + self.tones[0] * self.subcarrier_spacing_hz <= 0:
                raise ValueError(f"tone {self.tones[0]} would be at a frequency that is not positive")
        for name, size in (("dead_antennas", self.antennas), ("dead_tones", self.subcarriers)):
            dead = _ascending(name, getattr(self, name))
            object.__setattr__(self, name, dead)
            if dead and not 0 <= dead[0] <= dead[-1] < size:
                raise ValueError(f"{name} must lie within 0 and {size - 1}, not {list(dead)}")
            if len(dead) == size:
                raise ValueError(f"{name} must leave one that counts, not name all {size}")

    def _check_elements(self) -> None:
        layouts.check_shape(self, SEES, CLOCK_SHARES)

    @property
    def theta_phase(self) -> float:
        """Phase step between neighbouring elements at theta = 0: u = theta_phase * cos(theta)."""
        return 2 * np.pi * self.element_spacing_m / self.wavelength_m

    @property
    def rho_phase(self) -> float:
        """Phase step between neighbouring tone numbers per metre: u = rho_phase * rho (negative)."""
        return -2 * np.pi * self.subcarrier_spacing_hz / self.light_speed_m_s

    @property
    def tone_numbers(self) -> NDArray[np.int64]:
        """Numbers (subcarriers,) of the subcarriers."""
        return np.arange(self.subcarriers) if self.tones is None else np.array(self.tones, np.int64)

    @property
    def frequencies_hz(self) -> FloatArray:
        """Frequencies (subcarriers,) of the subcarriers."""
        return self.carrier_hz + self.tone_numbers.astype(np.float64) * self.subcarrier_spacing_hz

    @property
    def offsets_hz(self) -> FloatArray:
        """Frequencies (subcarriers,) of the subcarriers, less that of tone 0."""
        return self.tone_numbers.astype(np.float64) * self.subcarrier_spacing_hz

    @property
    def live_antennas(self) -> NDArray[np.bool_]:
        """Which elements count, (antennas,)."""
        return _without(self.antennas, self.dead_antennas)

    @property
    def live_tones(self) -> NDArray[np.bool_]:
        """Which subcarriers count, (subcarriers,)."""
        return _without(self.subcarriers, self.dead_tones)

    @property
    def middle_hz(self) -> float:
        """Mean frequency of the subcarriers that count."""
        return float(self.frequencies_hz[self.live_tones].mean())

    @property
    def unambiguous_rho_m(self) -> float:
        """Largest range that can be told from zero, c / (spacing * d).

        d is the greatest common divisor of the distances between the tones that count.
        """
        steps = np.diff(self.tone_numbers[self.live_tones])
        common = max(int(np.gcd.reduce(steps)), 1) if len(steps) else 1
        return self.light_speed_m_s / (self.subcarrier_spacing_hz * common)

    @classmethod
    def of_elements(
        cls,
        name: str,
        elements: NDArray[Any],
        subcarriers: int,
        carrier_hz: float,
        subcarrier_spacing_hz: float,
        **others: Any,
    ) -> ArrayGeometry:
        """An array of any shape: `elements` (N, 3) along (right, up, normal); `others` are further fields.

        `chachart.node.data.elements` has boards and circles.
        """
        places = np.asarray(elements, np.float64)
        layouts.check(places, len(places), 0.0)
        board = layouts.lattice(places) if len(places) > 1 else None
        if board is not None and board.rows == 1 and (board.column == np.arange(len(places))).all():
            others["position_m"] = layouts.first_of_line(places, **others)
            across = float(board.column_spacing_m)
            return cls(name, len(places), subcarriers, carrier_hz, subcarrier_spacing_hz, across, **others)
        light = others.get("light_speed_m_s", SPEED_OF_LIGHT)
        apart = layouts.least_distance(places) if len(places) > 1 else light / carrier_hz / 2
        return cls(
            name=name,
            antennas=len(places),
            subcarriers=subcarriers,
            carrier_hz=carrier_hz,
            subcarrier_spacing_hz=subcarrier_spacing_hz,
            element_spacing_m=apart,
            elements=tuple((float(x), float(y), float(z)) for x, y, z in places),
            **others,
        )

    def mismatches(self, other: ArrayGeometry) -> list[str]:
        """What differs between two descriptions of one array, one phrase a field.

        Name, calibration and what is dead do not count: they may change while the array stays the same.
        """
        free = ("name", "calibration", "dead_antennas", "dead_tones", "tones")
        return [
            f"{f.name}: {_brief(getattr(self, f.name))} against {_brief(getattr(other, f.name))}"
            for f in fields(self)
            if f.name not in free and not _same(getattr(self, f.name), getattr(other, f.name))
        ] + self._tone_mismatches(other)

    def completed(self, carried: ArrayGeometry) -> ArrayGeometry:
        """This description of an array with what another one of it knows besides.

        That is the calibration, where there is none here, and what else is dead.
        """
        return replace(
            self,
            calibration=self.calibration or carried.calibration,
            dead_antennas=tuple(sorted({*self.dead_antennas, *carried.dead_antennas})),
            dead_tones=tuple(sorted({*self.dead_tones, *carried.dead_tones})),
        )

    def _tone_mismatches(self, other: ArrayGeometry) -> list[str]:
        ours, theirs = self.tone_numbers, other.tone_numbers
        if len(ours) != len(theirs) or (ours == theirs).all():  # another number has been told already
            return []
        n = int(np.flatnonzero(ours != theirs)[0])
        return [f"tones: subcarrier {n} is number {ours[n]} against {theirs[n]}"]

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON and metadata; `from_dict` reads them back.

        What could not be told once goes without saying while it is as it was then.
        """
        left_out = {f.name for f in fields(self) if f.name in _LATER and getattr(self, f.name) == f.default}
        return {name: value for name, value in asdict(self).items() if name not in left_out}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ArrayGeometry:
        """Build from `as_dict`'s values; unknown keys are an error.

        Raises
        ------
        ValueError
            If a key is unknown or missing, or a value does not fit.
        """
        known = {f.name for f in fields(cls)}
        if unknown := sorted(set(values) - known):
            raise ValueError(f"unknown array fields: {', '.join(unknown)}")
        plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        if isinstance(plain.get("elements"), tuple):
            plain["elements"] = tuple(tuple(p) if isinstance(p, list) else p for p in plain["elements"])
        if plain.get("pattern") is not None:
            plain["pattern"] = Pattern.from_dict(plain["pattern"])
        if plain.get("calibration") is not None:
            plain["calibration"] = Calibration.from_dict(plain["calibration"])
        try:
            return cls(**plain)
        except (TypeError, OverflowError) as error:
            raise ValueError(f"not a description of an array: {error}") from None


def _same(a: Any, b: Any) -> bool:
    if a is None or b is None or isinstance(a, str | Pattern):
        return bool(a == b)
    return np.shape(a) == np.shape(b) and bool(np.allclose(a, b, rtol=1e-6, atol=1e-9))


def _brief(value: Any) -> str:
    return text if len(text := str(value)) <= 80 else f"{text[:77]}..."


def _ascending(name: str, values: Any) -> tuple[int, ...]:
    whole = isinstance(values, tuple | list | np.ndarray) and all(
        isinstance(v, int | np.integer) and not isinstance(v, bool) for v in values
    )
    if not whole:
        raise ValueError(f"{name} must be whole numbers, not {values!r}")
    numbers = tuple(int(v) for v in values)
    if any(b <= a for a, b in pairwise(numbers)):
        raise ValueError(f"{name} must ascend, each number once, not {list(numbers)}")
    return numbers


def _without(size: int, dead: tuple[int, ...]) -> NDArray[np.bool_]:
    live = np.ones(size, np.bool_)
    live[list(dead)] = False
    return live
