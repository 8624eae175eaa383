"""Files of arrays' poses and offsets: `chachart calibrate --arrays` writes what `fusion.calibration` has."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Literal

import numpy as np
import tomli_w
from pydantic import Field, ValidationError

from chachart.node.data.placement import Placement
from chachart.node.data.pose import Vector
from chachart.node.data.settings import Settings

NOT_SQUARE = 1e-6
"""Axes that are further from orthogonal, or from length 1, are none."""


class PlacementTable(Settings):
    """One array."""

    name: str
    """Which array."""
    offset_ns: float | None = Field(None, ge=-1e9, le=1e9)
    """How much later its clock says that everything arrives."""
    offset_std_ns: float = Field(0.0, ge=0)
    """Deviation of that."""
    position_m: Vector | None = None
    """As in [array]."""
    axis: Vector | None = None
    """As in [array]."""
    broadside: Vector | None = None
    """As in [array]."""
    position_std_m: Vector = (0.0, 0.0, 0.0)
    """Deviations of the array's middle."""
    turn_std_deg: Vector = (0.0, 0.0, 0.0)
    """Deviations of the orientation, about right, up and normal."""


class PlacementsFile(Settings):
    """Offsets and poses as they are kept."""

    version: Literal[1] = 1
    """Of this format."""
    note: str = Field("", max_length=1000)
    """Where they come from, for people."""
    array: tuple[PlacementTable, ...]
    """The arrays."""


def load_placements(path: Path) -> tuple[Placement, ...]:
    """The offsets and poses in a file.

    Raises
    ------
    ValueError
        If the file cannot be read or holds none.
    """
    try:
        file = PlacementsFile.model_validate(tomllib.loads(path.read_text("utf-8")))
    except OSError as error:
        raise ValueError(f"calibration {path} cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ValueError(f"{path} is no calibration of arrays: {where}: {first['msg']}") from None
    except ValueError as error:
        raise ValueError(f"{path} is no calibration of arrays: {error}") from None
    names = [table.name for table in file.array]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"{path}: array {', '.join(twice)} is there twice")
    found = []
    for table in file.array:
        pose = (table.position_m, table.axis, table.broadside)
        if any(part is None for part in pose) and any(part is not None for part in pose):
            raise ValueError(f"{path}: array {table.name} must have position_m, axis and broadside, or none")
        if table.axis is not None and table.broadside is not None:
            square = np.array([table.axis, table.broadside]) @ np.array([table.axis, table.broadside]).T
            if np.abs(square - np.eye(2)).max() > NOT_SQUARE:
                raise ValueError(
                    f"{path}: axis and broadside of array {table.name} must be orthogonal unit vectors"
                )
        found.append(
            Placement(
                table.name,
                None if table.offset_ns is None else table.offset_ns * 1e-9,
                table.offset_std_ns * 1e-9,
                *pose,
                table.position_std_m,
                _radians(table.turn_std_deg),
            )
        )
    return tuple(found)


def save_placements(path: Path, placements: tuple[Placement, ...], note: str) -> None:
    """Write offsets and poses to a file.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    tables = []
    for one in placements:
        table: dict[str, object] = {"name": one.name}
        if one.offset_s is not None:
            table |= {"offset_ns": round(1e9 * one.offset_s, 4)}
            table |= {"offset_std_ns": round(1e9 * one.offset_std_s, 4)}
        if one.position_m is not None and one.axis is not None and one.broadside is not None:
            table |= {
                "position_m": [round(v, 6) for v in one.position_m],
                "axis": list(one.axis),
                "broadside": list(one.broadside),
                "position_std_m": [round(v, 6) for v in one.position_std_m],
                "turn_std_deg": [round(math.degrees(v), 5) for v in one.turn_std_rad],
            }
        tables.append(table)
    path.write_text(tomli_w.dumps({"version": 1, "note": note, "array": tables}), "utf-8")


def _radians(degrees: Vector) -> Vector:
    x, y, z = degrees
    return (math.radians(x), math.radians(y), math.radians(z))
