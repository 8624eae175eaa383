"""The rows of a chart log as CSV, Parquet and GeoJSON files."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.exporting.geodesy import beside
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.node.data.geometry import ArrayGeometry

GROUP_ROWS = 65_536
"""Rows of a Parquet row group."""
COLUMNS = {
    "theta": "theta_rad",
    "rho": "rho_m",
    "theta_std": "theta_std_rad",
    "rho_std": "rho_std_m",
    "x": "x_m",
    "y": "y_m",
    "snr": "snr_db",
    "snapshots": "snapshots",
}
"""Columns of a chart, and what they are called in a file."""
POSITION = ("position_x_m", "position_y_m", "position_z_m")
LEVEL = 0.5
"""Broadside and axis span at least so much of a horizontal plane, or the chart is no map."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where the middle of an array is, in degrees (WGS 84), and which way its broadside looks.

    `heading_deg` is that of the chart's x axis, clockwise from true north.
    """

    latitude_deg: float
    longitude_deg: float
    heading_deg: float

    def coordinates(self, chart: ChartUpdate, array: ArrayGeometry) -> NDArray[np.float64]:
        """Longitude and latitude (K, 2) of the chart's UEs.

        The chart's y axis is to the left of x or to the right, as axis and broadside are in the array's
        world, whose z axis is up.

        Raises
        ------
        SetupError
            If the array stands upright, so that the chart is no map, or there is no such place.
        """
        left = float(np.cross(array.broadside, array.axis)[2])
        if abs(left) < LEVEL:
            raise SetupError(
                "the array's axis and broadside are not level: its chart is no map of the ground"
            )
        heading = np.radians(self.heading_deg)
        y = np.sign(left) * chart.y
        east = chart.x * np.sin(heading) - y * np.cos(heading)
        north = chart.x * np.cos(heading) + y * np.sin(heading)
        try:
            latitude, longitude = beside(self.latitude_deg, self.longitude_deg, east, north)
        except ValueError as error:
            raise SetupError(str(error)) from None
        return np.stack([longitude, latitude], axis=1)


def _table(chart: ChartUpdate) -> dict[str, Any]:
    """The rows as columns."""
    rows = len(chart)
    position = np.full((rows, 3), np.nan, np.float32) if chart.position is None else chart.position
    return {
        "ue": chart.ue,
        "time_ns": chart.time_ns,
        **{name: getattr(chart, column) for column, name in COLUMNS.items()},
        **{name: position[:, i] for i, name in enumerate(POSITION)},
        "array": [chart.array] * rows,
        "theta_method": [chart.method.theta] * rows,
        "rho_method": [chart.method.rho] * rows,
    }


def _plain(values: Any) -> list[Any]:
    """A column as plain values, None where not finite."""
    if isinstance(values, list):
        return values
    plain: list[Any] = values.tolist()
    if np.issubdtype(values.dtype, np.floating):
        if values.dtype == np.float32:
            plain = [float(str(value)) for value in values]  # not the many digits of its double
        for row in np.flatnonzero(~np.isfinite(values)).tolist():
            plain[row] = None
    return plain


def _csv(path: Path, charts: Iterator[ChartUpdate], array: ArrayGeometry, place: Place | None) -> int:
    rows = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for chart in charts:
            table = _table(chart)
            if rows == 0:
                writer.writerow(table)
            writer.writerows(zip(*map(_plain, table.values()), strict=True))
            rows += len(chart)
    return rows


def _parquet(path: Path, charts: Iterator[ChartUpdate], array: ArrayGeometry, place: Place | None) -> int:
    require("parquet", f"{path}:")
    import pyarrow as pa
    from pyarrow import parquet

    rows, waiting, writer = 0, [], None
    try:
        for chart in charts:
            table = pa.table({name: pa.array(v, from_pandas=True) for name, v in _table(chart).items()})
            if writer is None:
                about = {"chachart.array": json.dumps(array.as_dict())}
                writer = parquet.ParquetWriter(path, table.schema.with_metadata(about), compression="zstd")
            waiting.append(table.cast(writer.schema))
            rows += len(chart)
            if sum(map(len, waiting)) >= GROUP_ROWS:
                writer.write_table(pa.concat_tables(waiting), GROUP_ROWS)
                waiting = []
        if writer is not None and waiting:
            writer.write_table(pa.concat_tables(waiting), GROUP_ROWS)
    finally:
        if writer is not None:
            writer.close()
    return rows


def _geojson(path: Path, charts: Iterator[ChartUpdate], array: ArrayGeometry, place: Place | None) -> int:
    if place is None:
        raise SetupError("GeoJSON needs the array's place: --latitude, --longitude and --heading-deg")
    rows = 0
    with path.open("w", encoding="utf-8") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for chart in charts:
            table = _table(chart)
            times = table.pop("time_ns")
            table["time"] = [
                datetime.fromtimestamp(t / 1e9, UTC).isoformat(timespec="microseconds")
                for t in times.tolist()
            ]
            points = np.round(place.coordinates(chart, array), 8).tolist()
            for point, row in zip(points, zip(*map(_plain, table.values()), strict=True), strict=True):
                feature = {
                    "type": "Feature",
                    "geometry": {"type": "Point", "coordinates": point},
                    "properties": dict(zip(table, row, strict=True)),
                }
                file.write(("," if rows else "") + "\n" + json.dumps(feature))
                rows += 1
        file.write("\n]}\n")
    return rows


Writer = Callable[[Path, Iterator[ChartUpdate], ArrayGeometry, Place | None], int]
WRITERS: dict[str, Writer] = {".csv": _csv, ".parquet": _parquet, ".geojson": _geojson}
"""By the ending of the file's name; each returns how many rows there were, and raises SetupError where a
package or the place is missing."""
