"""Files that describe antenna arrays: CSV lists, `spec.json` of DICHASUS and ESPARGOS data, pyespargos YAML.

All of them become an `ArrayFile`: elements along (right, up, normal), and what else the file knows.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.elements import grid
from chachart.node.data.extras import require
from chachart.node.data.pattern import Pattern
from chachart.node.data.pose import Vector

ESPARGOS_SPACING_M = 0.06
"""Between neighbouring antennas of an ESPARGOS board, both ways."""
ESPARGOS_ROWS, ESPARGOS_COLUMNS = 2, 4

MAX_ELEMENTS = 1024


@dataclass(frozen=True, slots=True, eq=False)
class ArrayFile:
    """What a file says of an array.

    Attributes
    ----------
    elements
        (N, 3) along (right, up, normal), metres.
    position_m, right, up
        Its pose; None where the file has none.
    channels
        For each element the number of its channel in the capture; None where that is its own number.
    pattern
        Of the elements; None where the file has none.
    """

    elements: NDArray[np.float64]
    position_m: Vector | None = None
    right: Vector | None = None
    up: Vector | None = None
    channels: tuple[int, ...] | None = None
    pattern: Pattern | None = None


def read_array_file(path: Path, array: int | None, spacing_m: float | None) -> ArrayFile:
    """The array in a file; its suffix says what kind of file it is.

    Parameters
    ----------
    path
        `.csv`, `.json`, `.yml` or `.qdant`.
    array
        Which of the arrays in the file, from 0; None if it has only one.
    spacing_m
        Between neighbouring elements, for files that do not say it.

    Raises
    ------
    ValueError
        If the file cannot be read or does not describe such an array.
    SetupError
        If a library is missing.
    """
    readers: dict[str, Callable[[Path, int | None, float | None], ArrayFile]] = {
        ".csv": _from_csv,
        ".json": _from_spec,
        ".yml": _from_yaml,
        ".yaml": _from_yaml,
        ".qdant": _from_qdant,
    }
    if path.suffix.lower() not in readers:
        raise ValueError(f"{path}: no array file ends in {path.suffix!r}, only {', '.join(readers)}")
    try:
        found = readers[path.suffix.lower()](path, array, spacing_m)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not UTF-8 text") from None
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError(f"{path} does not describe an array: {error!r}") from None
    if not 1 <= len(found.elements) <= MAX_ELEMENTS:
        raise ValueError(f"{path} has {len(found.elements)} elements instead of 1 to {MAX_ELEMENTS}")
    return found


def _from_csv(path: Path, array: int | None, spacing_m: float | None) -> ArrayFile:
    """One element a line: right, up, normal in metres; a head line and lines that begin with # are fine."""
    places: list[list[float]] = []
    with path.open(newline="", encoding="utf-8") as file:
        for number, row in enumerate(csv.reader(file), 1):
            if not row or row[0].lstrip().startswith("#"):
                continue
            try:
                place = [float(cell) for cell in row]
            except ValueError:
                if not places and number == 1:
                    continue
                raise ValueError(f"{path}, line {number}: {','.join(row)!r} is not right,up,normal") from None
            if len(place) not in (2, 3) or not all(map(math.isfinite, place)):
                raise ValueError(f"{path}, line {number}: must be right,up or right,up,normal in metres")
            places.append([*place, 0.0][:3])
    if not places:
        raise ValueError(f"{path} has no elements: one a line, right,up,normal in metres")
    return ArrayFile(np.array(places))


def _from_spec(path: Path, array: int | None, spacing_m: float | None) -> ArrayFile:
    """`antennas[array]` of a spec.json: rows of channel numbers, where it is and which way it looks."""
    try:
        spec = json.loads(path.read_text("utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path} is not JSON: {error}") from None
    if not isinstance(spec, Mapping) or not isinstance(spec.get("antennas"), list) or not spec["antennas"]:
        raise ValueError(f'{path} has no list "antennas", as spec.json of DICHASUS and ESPARGOS data has')
    one = _pick(path, spec["antennas"], array)
    rows = one.get("assignments")
    if not isinstance(rows, list) or not rows or len({len(row) for row in rows}) != 1:
        raise ValueError(f'{path}: "assignments" of the array must be rows of channel numbers, alike long')
    channels = [int(channel) for row in rows for channel in row]
    if len(set(channels)) < len(channels):
        raise ValueError(f'{path}: "assignments" has a channel twice')
    across, down = _spec_spacing(one, spacing_m)
    if across is None or down is None:
        raise ValueError(f"{path} does not say how far apart the elements are: set element_spacing_m")
    right, up = _spec_frame(path, one)
    return ArrayFile(
        grid(len(rows), len(rows[0]), across, down),
        None if "location" not in one else _vector(path, one["location"]),
        right,
        up,
        None if channels == list(range(len(channels))) else tuple(channels),
    )


def _spec_spacing(one: Mapping[str, Any], spacing_m: float | None) -> tuple[float | None, float | None]:
    """Between columns and between rows, under any of the names that data sets use."""
    both = one.get("spacing")
    across = one.get("spacingHorizontal", one.get("spacing_horizontal", one.get("column_spacing")))
    down = one.get("spacingVertical", one.get("spacing_vertical", one.get("row_spacing")))
    if isinstance(both, Mapping):
        across, down = both.get("horizontal", across), both.get("vertical", down)
    elif isinstance(both, int | float):
        across, down = across or both, down or both
    return (across or spacing_m), (down or spacing_m)


def _spec_frame(path: Path, one: Mapping[str, Any]) -> tuple[Vector | None, Vector | None]:
    """Right and up; from the direction it looks to, as if it hung upright, where that is all there is."""
    if "rightvector" in one and "upvector" in one:
        return _vector(path, one["rightvector"]), _vector(path, one["upvector"])
    if "direction" not in one:
        return None, None
    normal = np.array(_vector(path, one["direction"]))
    right = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(right) < 1e-6:
        raise ValueError(f"{path}: an array that looks up or down needs rightvector and upvector")
    up = np.cross(normal, right)
    return _unit(right), _unit(up)


def _from_yaml(path: Path, array: int | None, spacing_m: float | None) -> ArrayFile:
    """A pyespargos `combined-array`: a rectangle of "board.row.column", board after board in the frames."""
    require("yaml", f"{path}:")
    import yaml

    try:
        document = yaml.safe_load(path.read_text("utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is not YAML: {' '.join(str(error).split())}") from None
    combined = document.get("combined-array", document) if isinstance(document, Mapping) else {}
    rows, boards = combined.get("array"), list(combined.get("boards", ()))
    if not isinstance(rows, list) or not rows or len({len(row) for row in rows}) != 1 or not boards:
        raise ValueError(f'{path} needs "boards" and a rectangular "array", as pyespargos has them')
    channels = []
    for name in (name for row in rows for name in row):
        board, row, column = str(name).rsplit(".", 2)
        if board not in boards or not (0 <= int(row) < ESPARGOS_ROWS and 0 <= int(column) < ESPARGOS_COLUMNS):
            raise ValueError(f"{path}: {name!r} is no antenna of the boards {', '.join(map(str, boards))}")
        channels.append((boards.index(board) * ESPARGOS_ROWS + int(row)) * ESPARGOS_COLUMNS + int(column))
    if len(set(channels)) < len(channels):
        raise ValueError(f"{path}: an antenna is twice in the array")
    spacing = spacing_m or ESPARGOS_SPACING_M
    order = None if channels == list(range(len(channels))) else tuple(channels)
    return ArrayFile(grid(len(rows), len(rows[0]), spacing), channels=order)


def _from_qdant(path: Path, array: int | None, spacing_m: float | None) -> ArrayFile:
    """QuaDRiGa's array antenna: x is normal, y right, z up; the vertically polarised pattern counts."""
    require("patterns", f"{path}:")
    from quadriga_lib import arrayant

    if not path.is_file():
        raise ValueError(f"{path} cannot be read: there is no such file")
    try:
        read = arrayant.qdant_read(str(path), (array or 0) + 1)
    except (RuntimeError, ValueError) as error:
        raise ValueError(f"{path} is no QDANT file: {error}") from None
    azimuth, elevation = (np.asarray(read[name]).ravel() for name in ("azimuth_grid", "elevation_grid"))
    whole = (
        np.allclose(np.diff(azimuth), azimuth[1] - azimuth[0], rtol=1e-4)
        and np.allclose(np.diff(elevation), elevation[1] - elevation[0], rtol=1e-4)
        and abs(azimuth[0] + np.pi) < 1e-3
        and azimuth[-1] > np.pi - 1.01 * (azimuth[1] - azimuth[0])
        and np.allclose(elevation[[0, -1]], [-np.pi / 2, np.pi / 2], atol=1e-3)
    )
    if not whole:
        raise ValueError(f"{path}: the pattern must be sampled evenly over the whole sphere")
    gains = np.asarray(read["e_theta_re"]) + 1j * np.asarray(read["e_theta_im"])
    gains = np.moveaxis(gains.reshape(len(elevation), len(azimuth), -1), 2, 0)
    forward, right, up = np.asarray(read["element_pos"], np.float64).reshape(3, -1)
    return ArrayFile(np.stack([right, up, forward], axis=1), pattern=Pattern.of_samples(gains))


def _pick(path: Path, arrays: list[Any], array: int | None) -> Mapping[str, Any]:
    if array is None and len(arrays) > 1:
        raise ValueError(f"{path} has {len(arrays)} arrays: say which, file_array = 0 to {len(arrays) - 1}")
    if not 0 <= (array or 0) < len(arrays):
        raise ValueError(f"{path} has arrays 0 to {len(arrays) - 1}, no {array}")
    one = arrays[array or 0]
    if not isinstance(one, Mapping):
        raise ValueError(f"{path}: array {array or 0} is not an object")
    return one


def _vector(path: Path, values: Any) -> Vector:
    vector = np.asarray(values, np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{path}: {values!r} must be 3 numbers")
    x, y, z = vector.tolist()
    return (x, y, z)


def _unit(values: NDArray[np.float64]) -> Vector:
    x, y, z = (values / np.linalg.norm(values)).tolist()
    return (x, y, z)
