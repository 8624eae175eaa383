"""Turn a recording or a chart log into a file for other tools. What it is, its content says.

    chachart export capture.mcap capture.mat       or .npz (NumPy), .h5, .hdf5 (HDF5); .mat is MATLAB v5
    chachart export chart.mcap chart.csv           or .parquet; one row an estimate
    chachart export chart.mcap chart.geojson --newest --latitude 48.1374 --longitude 11.5755 --heading-deg 90

Of a recording: csi (frames, antennas, subcarriers), ue, time_ns, position where known, and array, the
description of the array as JSON. Nothing is rounded: `chachart import` makes the same frames of it again,
with --csi csi --ue ue --time time_ns --position position.

GeoJSON has a point a row. --latitude and --longitude say where the middle of the array is (WGS 84), and
--heading-deg which way its broadside, the chart's x axis, looks: clockwise from true north, 90 is east.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from chachart.node.commands.exporting import frames, rows
from chachart.node.commands.shared.cli import check_writable, written_whole
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.files.chart_log import ChartLogReader, is_chart_log, newest
from chachart.node.files.recording import RecordingReader


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart export`."""
    parser.add_argument("file", type=Path, metavar="IN.mcap", help="the recording or the chart log")
    parser.add_argument(
        "out",
        type=Path,
        metavar="OUT",
        help=f"{', '.join(frames.WRITERS)} of a recording, {', '.join(rows.WRITERS)} of a chart log",
    )
    parser.add_argument("--from", dest="from_s", type=float, default=0.0, metavar="S", help="begin so late")
    parser.add_argument("--to", dest="to_s", type=float, metavar="S", help="end after so many seconds")
    parser.add_argument("--force", action="store_true", help="replace OUT if it exists")
    logs = parser.add_argument_group("chart logs")
    logs.add_argument("--newest", action="store_true", help="only the newest row of each UE")
    logs.add_argument("--latitude", type=float, metavar="DEG", help="of the middle of the array")
    logs.add_argument("--longitude", type=float, metavar="DEG", help="of the middle of the array")
    logs.add_argument("--heading-deg", type=float, metavar="DEG", help="of the chart's x axis, from north")


def run(arguments: argparse.Namespace) -> int:
    """Export the recording or the chart log.

    Raises
    ------
    SetupError
        If it cannot be read or has nothing in that time, or the file cannot be written.
    """
    logged = is_chart_log(arguments.file)
    suffix = arguments.out.suffix.lower()
    endings = rows.WRITERS if logged else frames.WRITERS
    if suffix not in endings:
        kind = f"; {arguments.file} is a chart log" if logged else ""
        raise SetupError(f"{arguments.out} must end in one of {', '.join(endings)}{kind}")
    check_writable(arguments.out, arguments.force)
    if logged:
        _export_rows(arguments, rows.WRITERS[suffix])
    else:
        reader = RecordingReader(arguments.file)
        start = reader.start_ns or 0
        end = None if arguments.to_s is None else start + round(arguments.to_s * 1e9)
        blocks = list(reader.blocks(start + round(arguments.from_s * 1e9), end))
        if not blocks:
            raise SetupError(f"{arguments.file} has no frames in that time")
        block = CsiBlock.concatenate(blocks)
        variables: frames.Variables = {"csi": block.csi, "ue": block.ue, "time_ns": block.time_ns}
        if block.position is not None:
            variables["position"] = block.position
        variables["array"] = json.dumps(reader.array.as_dict())
        with written_whole(arguments.out) as part:
            frames.WRITERS[suffix](part, variables)
        shape = " x ".join(map(str, block.csi.shape))
        print(f"{arguments.out}: csi {shape}, {', '.join(list(variables)[1:])}")
    return 0


def _export_rows(arguments: argparse.Namespace, write: rows.Writer) -> None:
    place = None
    given = (arguments.latitude, arguments.longitude, arguments.heading_deg)
    if all(value is not None for value in given):
        place = rows.Place(*given)
    reader = ChartLogReader(arguments.file)
    names = {name for chart in _charts(ChartLogReader(arguments.file), arguments) for name in chart.columns}
    with written_whole(arguments.out) as part:
        count = write(part, _charts(reader, arguments), rows.Table(names, reader.array), place)
        if not count:
            raise SetupError(f"{arguments.file} has no rows in that time")
    for reason, damaged in reader.damaged.as_dict().items():
        print(f"{arguments.file}: left out {damaged} ({reason})", file=sys.stderr)
    print(f"{arguments.out}: {count} rows")


def _charts(reader: ChartLogReader, arguments: argparse.Namespace) -> Iterator[ChartUpdate]:
    """The updates of the log in the time asked for, or the newest rows of them."""
    updates = _between(reader.charts(), arguments.from_s, arguments.to_s)
    if not arguments.newest:
        yield from updates
    elif (chart := newest(updates)) is not None:
        yield chart


def _between(updates: Iterator[ChartUpdate], from_s: float, to_s: float | None) -> Iterator[ChartUpdate]:
    """Their rows of a stretch of time, which counts from the first row of all."""
    start_ns = None
    for update in updates:
        if start_ns is None:
            start_ns = int(update.time_ns.min())
        seconds = (update.time_ns - start_ns) / 1e9
        wanted = np.ones(len(update), bool) if from_s <= 0 else seconds >= from_s
        if to_s is not None:
            wanted &= seconds < to_s
        if wanted.any():
            yield update.take(wanted)
