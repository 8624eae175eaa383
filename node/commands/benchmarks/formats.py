"""Formats: how fast captures are read and decoded, in megabytes of file a second."""

from __future__ import annotations

import argparse
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from chachart.node.commands.benchmarks import captures
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.timing import Timing, time_in_turn
from chachart.sources.formats import open_capture

WIFI = ("intel5300", "atheros", "nexmon", "nexmon pcapng", "feitcsi", "picoscenes", "esp32")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench formats`."""
    parser.add_argument(
        "captures", type=Path, nargs="*", metavar="FILE", help="captures, instead of made-up ones"
    )
    parser.add_argument(
        "--megabytes", type=int, default=16, help="of each made-up one (default: %(default)s)"
    )
    parser.add_argument("--runs", type=int, default=5, help="repetitions (default: %(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Open each capture several times in turn."""
    table = Table(
        "Captures opened and decoded, from the page cache",
        ["capture", "MB", "frames", "MB/s", "thousand frames/s"],
    )
    with tempfile.TemporaryDirectory(prefix="chachart-bench-") as folder:
        files = {path.name: path for path in arguments.captures}
        if not files:
            files = {name: _written(Path(folder), name, arguments.megabytes) for name in WIFI}
        timings = time_in_turn(
            {n: partial(open_capture, path) for n, path in files.items()}, runs=arguments.runs
        )
        for name, path in files.items():
            timing, size = timings[name], path.stat().st_size
            frames = open_capture(path).variables
            count = max((variable.shape[0] for variable in frames.values() if variable.shape), default=0)
            rate = Timing(*(size / 1e6 / s for s in (timing.median, timing.most, timing.least)))
            table.add(name, size / 1e6, count, rate, count / timing.median / 1e3)
    return [table]


def _written(folder: Path, name: str, megabytes: int) -> Path:
    piece = captures.made(name, 64, np.random.default_rng(0))
    frames = max(1, megabytes * 1_000_000 * 64 // len(piece))
    path = folder / name.replace(" ", "-")
    path.write_bytes(captures.made(name, frames, np.random.default_rng(1)))
    return path
