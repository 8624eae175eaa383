"""Where the transmitter was in each file: --position X,Y,Z once a file, or a table of files."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.shared.geodesy import seen_from
from chachart.node.data.errors import SetupError

Place = tuple[float, float, float]


def of_table(table: Path, files: list[Path], z_m: float) -> list[Place]:
    """The place of each file by a CSV table of file, x, y and perhaps z, in metres.

    A first line of headings is passed over; files are found by name, with or without what follows the dot.

    Raises
    ------
    SetupError
        If the table cannot be read, or has no place for a file.
    """
    known: dict[str, Place] = {}
    try:
        with table.open(newline="", encoding="utf-8-sig") as opened:
            for number, row in enumerate(csv.reader(opened), 1):
                words = [word.strip() for word in row]
                if not any(words):
                    continue
                try:
                    x, y, *z = (float(word) for word in words[1:4] if word)
                except ValueError:
                    if number == 1:
                        continue
                    raise SetupError(f"{table}, line {number}: must be file,x,y or file,x,y,z") from None
                place = x, y, z[0] if z else z_m
                if not np.isfinite(place).all():
                    raise SetupError(f"{table}, line {number}: the place must be finite, not {place}")
                known[words[0]] = known[Path(words[0]).stem] = place
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SetupError(f"--position-from {table} cannot be read: {error}") from None
    places = []
    for file in files:
        found = next((known[key] for key in (str(file), file.name, file.stem) if key in known), None)
        if found is None:
            raise SetupError(f"--position-from {table} has no line for {file.name}")
        places.append(found)
    return places


def repeated(place: NDArray[Any], count: int) -> NDArray[np.float32]:
    """float32 (count, 3)."""
    return np.tile(place.astype(np.float32), (count, 1))


def in_metres(values: NDArray[Any], unit: str, origin: tuple[float, float] | None) -> NDArray[Any]:
    """Positions (N, 2 or 3) in metres: of `deg`, those of latitude and longitude east and north of `origin`.

    Raises
    ------
    ValueError
        If the origin is not given, or a position is no place on earth.
    """
    if unit == "m":
        return values
    if origin is None:
        raise ValueError("--position-unit deg needs --origin LAT,LON: where x = y = 0 is")
    if values.ndim != 2 or values.shape[1] not in (2, 3):
        raise ValueError(f"must be latitude, longitude and perhaps height a row, not shape {values.shape}")
    whole = values.astype(np.float64)
    if (np.abs(whole[:, 0]) > 90).any() or (np.abs(whole[:, 1]) > 180).any():
        raise ValueError("latitudes are within 90 degrees, longitudes within 180")
    whole[:, 0], whole[:, 1] = seen_from(*origin, whole[:, 0], whole[:, 1])
    return whole
