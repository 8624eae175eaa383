"""The rows of a chart log as CSV, Parquet and GeoJSON files."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.shared.geodesy import beside
from chachart.node.commands.shared.tables import harmless
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.columns import COLUMNS, rounded
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.node.data.geometry import ArrayGeometry

GROUP_ROWS = 65_536
"""Rows of a Parquet row group."""
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


@dataclass(frozen=True, slots=True)
class Table:
    """How rows of a chart look in every file: units in the names, truth in world and chart coordinates.

    `names` are the schema's columns that the file has; a row without one is filled in.
    """

    names: Collection[str]
    array: ArrayGeometry

    def columns(self, chart: ChartUpdate) -> dict[str, NDArray[Any] | list[str]]:
        """The rows as columns, nothing rounded."""
        return {name: values for name, _, values in self._columns(chart)} | self._words(chart)

    def rows(self, chart: ChartUpdate) -> Iterator[tuple[Any, ...]]:
        """The rows one by one as plain values, with the digits that say something; None where unknown."""
        numbers = [rounded(values, decimals) for _, decimals, values in self._columns(chart)]
        return zip(*numbers, *self._words(chart).values(), strict=True)

    def _columns(self, chart: ChartUpdate) -> Iterator[tuple[str, int, NDArray[Any]]]:
        for column in COLUMNS.values():
            if column.name in self.names:
                for name, values in column.flat(chart[column.name]):
                    yield column.file_name(name), column.decimals, values
        if "position" in self.names:
            for name, values in zip(("true_x_m", "true_y_m"), chart.truth_of(self.array), strict=True):
                yield name, COLUMNS["x"].decimals, values

    @staticmethod
    def _words(chart: ChartUpdate) -> dict[str, list[str]]:
        words = {"array": chart.array, "theta_method": chart.method.theta, "rho_method": chart.method.rho}
        return {name: [harmless(word)] * len(chart) for name, word in words.items()}


def write_csv(path: Path, charts: Iterable[ChartUpdate], table: Table, place: Place | None = None) -> int:
    """The rows as CSV, unknown values empty; how many there were."""
    rows = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for chart in charts:
            if rows == 0:
                writer.writerow(table.columns(chart))
            writer.writerows(table.rows(chart))
            rows += len(chart)
    return rows


def _parquet(path: Path, charts: Iterable[ChartUpdate], table: Table, place: Place | None) -> int:
    require("parquet", "Parquet:")
    import pyarrow as pa
    from pyarrow import parquet

    rows, waiting, writer = 0, [], None
    try:
        for chart in charts:
            part = pa.table({name: pa.array(v, from_pandas=True) for name, v in table.columns(chart).items()})
            if writer is None:
                about = {"chachart.array": json.dumps(table.array.as_dict())}
                writer = parquet.ParquetWriter(path, part.schema.with_metadata(about), compression="zstd")
            waiting.append(part.cast(writer.schema))
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


def _geojson(path: Path, charts: Iterable[ChartUpdate], table: Table, place: Place | None) -> int:
    if place is None:
        raise SetupError("GeoJSON needs the array's place: --latitude, --longitude and --heading-deg")
    rows = 0
    with path.open("w", encoding="utf-8") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for chart in charts:
            names = list(table.columns(chart))
            points = np.round(place.coordinates(chart, table.array), 8).tolist()
            for point, row in zip(points, table.rows(chart), strict=True):
                properties = dict(zip(names, row, strict=True))
                properties["time"] = _time(properties.pop("time_ns"))
                feature = {
                    "type": "Feature",
                    "geometry": {"type": "Point", "coordinates": point},
                    "properties": properties,
                }
                file.write(("," if rows else "") + "\n" + json.dumps(feature))
                rows += 1
        file.write("\n]}\n")
    return rows


def _time(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).isoformat(timespec="microseconds")


Writer = Callable[[Path, Iterable[ChartUpdate], Table, Place | None], int]
WRITERS: dict[str, Writer] = {".csv": write_csv, ".parquet": _parquet, ".geojson": _geojson}
"""By the ending of the file's name; each returns how many rows there were, and raises SetupError where a
package or the place is missing."""
