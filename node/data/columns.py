"""The columns of a chart row: what everything that carries charts iterates.

A new column is one entry in `COLUMNS`. With `optional=True` nothing else has to know it: the wire, the
table, logs, the live view, exports and tools carry it wherever an estimator gives it, and a receiver fills
it in where it is missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.path_list import PARTS

_FILE_UNITS = {"": "", "ns": "", "rad": "_rad", "m": "_m", "s": "_s", "dB": "_db", "m/s": "_m_s", "m²": "_m2"}
"""What a name ends in where it is to say its unit; `time_ns` says it anyway."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column: K numbers, or (K, len(parts)) of them.

    Attributes
    ----------
    name, dtype
        What messages call it, and numpy's name of its type.
    label, about
        A word or two for people, and a sentence that says what it is.
    unit
        As people write it, "" where it has none.
    decimals
        Digits after the point that are worth keeping in text, in that unit.
    optional
        Whether rows may be without it; what every row has is typed in `ChartUpdate`.
    parts
        Of a column with several numbers a row, what each is called.
    """

    name: str
    dtype: str
    label: str
    about: str
    unit: str = ""
    decimals: int = 3
    optional: bool = False
    parts: tuple[str, ...] = ()

    @property
    def fill(self) -> float:
        """What stands where it is missing: NaN, or 0 in whole numbers."""
        return math.nan if np.dtype(self.dtype).kind == "f" else 0

    def shape(self, rows: int) -> tuple[int, ...]:
        """That of so many rows."""
        return (rows, len(self.parts)) if self.parts else (rows,)

    def missing(self, rows: int) -> NDArray[Any]:
        """So many rows without a value."""
        return np.full(self.shape(rows), self.fill, self.dtype)

    def known(self, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Which rows of `values` have a value."""
        there: NDArray[np.bool_] = np.isfinite(values) if math.isnan(self.fill) else values != self.fill
        return np.all(there, axis=1) if self.parts else there

    def plain(self, values: NDArray[Any]) -> list[Any]:
        """As plain numbers to `decimals`, None where not finite; with parts, a list a row."""
        plain = rounded(values.ravel(), self.decimals)
        width = len(self.parts)
        return [plain[at : at + width] for at in range(0, len(plain), width)] if width else plain

    def flat(self, values: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
        """The column as columns of one number a row, by name: `position_x` and so on."""
        if not self.parts:
            yield self.name, values
        for i, part in enumerate(self.parts):
            yield f"{self.name}_{part}", values[:, i]

    def file_name(self, name: str) -> str:
        """What a flat column is called in files, with its unit."""
        return name + _FILE_UNITS[self.unit]

    def for_people(self) -> tuple[str, float, int]:
        """Unit, factor and decimals of what people read: degrees for angles."""
        if self.unit == "rad":
            return "°", 180 / math.pi, max(0, self.decimals - 4)
        return self.unit, 1.0, min(self.decimals, 2)

    def text(self, value: Any) -> str:
        """A row's value as people read it, without its unit; a dash where it is unknown."""
        if self.parts:
            return ", ".join(self._one(part) for part in value)
        return self._one(value)

    def _one(self, value: Any) -> str:
        if value is None or value != value:
            return "-"
        _, factor, digits = self.for_people()
        return f"{value * factor:.{digits}f}" if digits else str(value)


def rounded(values: NDArray[Any], decimals: int) -> list[Any]:
    """Numbers (K,) as plain ones to so many decimals, None where not finite; whole numbers as they are."""
    if values.dtype.kind != "f":
        whole: list[Any] = values.tolist()
        return whole
    with np.errstate(over="ignore"):
        numbers = np.round(values.astype(np.float64), decimals)
    plain: list[Any] = numbers.tolist()
    for place in np.flatnonzero(~np.isfinite(numbers)).tolist():
        plain[place] = None
    return plain


_ALL = (
    Column("ue", "uint64", "UE", "Which UE.", decimals=0),
    Column("time_ns", "int64", "time", "Time of the last frame behind the estimate.", "ns", decimals=0),
    Column("theta", "float64", "θ", "Cone angle from the array's axis, 0 to π.", "rad", 6),
    Column("azimuth", "float64", "azimuth", "From the array's normal to its right.", "rad", 6, optional=True),
    Column("elevation", "float64", "elevation", "From the array's horizon upwards.", "rad", 6, optional=True),
    Column("rho", "float64", "ρ", "Slant range from the middle of the array.", "m"),
    Column("theta_std", "float64", "± θ", "Standard deviation of theta.", "rad", 6, optional=True),
    Column("azimuth_std", "float64", "± azimuth", "Standard deviation of azimuth.", "rad", 6, optional=True),
    Column(
        "elevation_std", "float64", "± elevation", "Standard deviation of elevation.", "rad", 6, optional=True
    ),
    Column(
        "relative",
        "int64",
        "relative",
        "1 where distances have no scale: rho, x and y are then no metres.",
        decimals=0,
        optional=True,
    ),
    Column("rho_std", "float64", "± ρ", "Standard deviation of rho.", "m", optional=True),
    Column(
        "p_direct", "float64", "direct", "Probability that the path found is the direct one.", optional=True
    ),
    Column("delay_spread", "float64", "delay spread", "Rms over the paths.", "s", 10, optional=True),
    Column("x", "float64", "x", "Towards a line's broadside; in the world for other arrays.", "m"),
    Column("y", "float64", "y", "Along a line's axis; in the world for other arrays.", "m"),
    Column("z", "float64", "z", "Height in the world.", "m", optional=True),
    Column("x_var", "float64", "σ² x", "Variance of x.", "m²", optional=True),
    Column("xy_cov", "float64", "σ xy", "Covariance of x and y.", "m²", optional=True),
    Column("y_var", "float64", "σ² y", "Variance of y.", "m²", optional=True),
    Column("z_var", "float64", "σ² z", "Variance of z.", "m²", optional=True),
    Column("vx", "float64", "v x", "Velocity along x.", "m/s", optional=True),
    Column("vy", "float64", "v y", "Velocity along y.", "m/s", optional=True),
    Column("arrays", "int64", "arrays", "How many arrays took part.", decimals=0, optional=True),
    Column("outlier", "float64", "outlier", "Probability of being more than 10 m off.", optional=True),
    Column(
        "paths",
        "float64",
        "paths",
        "Strongest paths of the newest frame: its level in dB; of each azimuth, elevation (rad), length (m), "
        "share of the power, phase.",
        decimals=6,
        optional=True,
        parts=PARTS,
    ),
    Column("snr", "float64", "SNR", "Signal to noise ratio.", "dB", 2),
    Column("snapshots", "float64", "frames", "Effective number of frames behind the estimate.", decimals=1),
    Column(
        "position",
        "float32",
        "true",
        "Known reference position in world metres.",
        "m",
        optional=True,
        parts=("x", "y", "z"),
    ),
)
COLUMNS: dict[str, Column] = {column.name: column for column in _ALL}
"""By name, in the order in which people read them."""


def markdown() -> str:
    """`COLUMNS` as a table for the documentation."""
    lines = ["| column | type | unit | |", "|---|---|---|---|"]
    for column in COLUMNS.values():
        kind = f"{column.dtype}{' × ' + str(len(column.parts)) if column.parts else ''}"
        notes = f"{column.about}{' May be missing.' if column.optional else ''}"
        lines.append(f"| `{column.name}` | {kind} | {column.unit} | {notes} |")
    return "\n".join(lines)
