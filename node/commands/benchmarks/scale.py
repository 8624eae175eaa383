"""Scale: frames a second with more workers, time a frame and memory with more UEs, antennas, subcarriers.

Sizes are measured in a fresh process each.

With --simulate, what numbers of UEs take that no machine at hand has: computed from what this one was
measured to need for one frame, one UE and one row.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks import simulate
from chachart.node.commands.benchmarks.arrays import SHAPES, an_array
from chachart.node.commands.benchmarks.kernels import PAIRS, noisy_blocks
from chachart.node.commands.benchmarks.report import Cell, Table
from chachart.node.commands.benchmarks.watched import Watched, watch
from chachart.node.commands.shared.cli import progress
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import RhoMethod, ThetaMethod
from chachart.node.estimation.estimator import ChartEstimator

UES = (1_000, 10_000, 100_000, 1_000_000)
SIZES = ((8, 32), (16, 32), (32, 32), (64, 32), (128, 32), (32, 1), (32, 8), (32, 64), (32, 128), (128, 128))
SIZE_UES = 1024
PARTS = {
    "reader": ("feeder", "reader"),
    "dispatcher": ("feeder", "main"),
    "a worker": ("worker",),
    "collector": ("main", "node"),
    "publisher": ("main", "sink publisher"),
    "ZeroMQ": ("", "io"),
}
"""Processes and threads that are told on their own."""
NODE_UES = 2048
BLOCK = 64
FULL, BUSY = 0.9, 0.6
"""Shares of all cores, and of one: busier than that, they are what ends it."""
COLUMNS = ["us a frame", "state bytes a UE", "peak MB"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench scale`."""
    parser.add_argument(
        "--max-ues", type=int, default=100_000, help="largest number of UEs (default: %(default)s)"
    )
    parser.add_argument("--theta", default="bartlett", choices=get_args(ThetaMethod))
    parser.add_argument("--rho", default="bartlett", choices=get_args(RhoMethod))
    parser.add_argument(
        "--workers", type=int, nargs="*", help="of a whole node (default: 1 to as many as there are cores)"
    )
    simulate.add_arguments(parser)


def run(arguments: argparse.Namespace) -> list[Table]:
    """Measure every number of workers and every size in turn, or what is needed to simulate."""
    if arguments.simulate is not None:
        return simulate.run(arguments, footprint)
    method = (arguments.theta, arguments.rho)
    ues = [n for n in UES if n <= arguments.max_ues]
    by_ues = Table(f"UEs of 32 x 32, {' / '.join(method)}", ["UEs", *COLUMNS])
    by_size = Table(f"array sizes, {SIZE_UES} UEs", ["antennas x subcarriers", "theta / rho", *COLUMNS])
    workers = _cores() if arguments.workers is None else arguments.workers
    with progress("measuring", len(workers) + len(ues) + len(SIZES)) as done:
        by_workers = _by_workers(workers, arguments.seconds, method, done)
        for n in ues:
            by_ues.add(n, *_cells(footprint(n, 32, 32, method), n))
            done(1)
        for antennas, subcarriers in SIZES:
            # One subcarrier has no delay to look for; the amplitude still ranges.
            fits = method if subcarriers > 1 else ("bartlett", "isq")
            found = footprint(SIZE_UES, antennas, subcarriers, fits)
            by_size.add(f"{antennas} x {subcarriers}", " / ".join(fits), *_cells(found, SIZE_UES))
            done(1)
    by_ues.notes = [
        "second frame of every UE; the peak is that of the whole process, Python and numpy included"
    ]
    return [by_workers, by_ues, by_size, _bytes()]


def _cores() -> list[int]:
    return list(range(1, len(os.sched_getaffinity(0)) + 1))


def _by_workers(
    workers: list[int], seconds: float, method: tuple[str, str], done: Callable[[int], None]
) -> Table:
    """Frames a second of a whole node, and which of its threads keeps it from more."""
    table = Table(
        f"a whole node at full speed, {NODE_UES} UEs of 32 x 32, {' / '.join(method)}: % of a core",
        ["workers", "frames/s", *PARTS, "all", "ends at"],
    )
    array = ArraySettings(subcarrier_spacing_hz=312500.0).geometry()
    blocks = noisy_blocks(array, NODE_UES, BLOCK)
    for count in workers:
        with tempfile.TemporaryDirectory(prefix="chachart-bench-") as name:
            seen = watch(Path(name), array, blocks, seconds, method, count)
        shares = {part: seen.share(seen.spent(*of)) for part, of in PARTS.items()}
        shares["a worker"] /= count
        shown: list[Cell] = [round(100 * share) for share in (*shares.values(), seen.share(seen.spent("")))]
        table.add(count, round(seen.frames_per_s), *shown, _ends_at(seen, shares))
        done(1)
    table.notes = [
        "a reader and its dispatcher share an interpreter, so do a collector and its publisher",
        "where none is busy, other programs have the cores",
    ]
    return table


def _ends_at(seen: Watched, shares: dict[str, float]) -> str:
    """What keeps a node from more: the cores, if they are full, else the busiest of what takes turns."""
    if seen.share(seen.spent("")) > FULL * len(_cores()):
        return "the cores"
    turns = {
        "feeder": shares["reader"] + shares["dispatcher"],
        "workers": shares["a worker"],
        "main process": shares["collector"] + shares["publisher"],
    }
    busiest = max(turns, key=lambda who: turns[who])
    return busiest if turns[busiest] > BUSY else "none is busy"


def _bytes() -> Table:
    """What every method keeps of a UE of every array."""
    table = Table("bytes a UE in an estimator", ["array", *(" / ".join(pair) for pair in PAIRS)])
    lines = {
        f"line of {antennas}, {tones} tones": ArrayGeometry("bench", antennas, tones, 3.5e9, 312_500.0, 0.04)
        for antennas, tones in SIZES
        if tones > 1
    }
    shapes = {f"{name}, {tones} tones": an_array(name) for name, (_, tones) in SHAPES.items()}
    for name, array in (lines | shapes).items():
        table.add(name, *(ChartEstimator(array, theta=t, rho=r).bytes_per_ue for t, r in PAIRS))
    table.notes = ["allocated as UEs come, in steps; worker and main process keep a row of each besides"]
    return table


def footprint(ues: int, antennas: int, subcarriers: int, method: tuple[str, str]) -> dict[str, float]:
    """What `footprint.py` measures in a process of its own."""
    options = {"ues": ues, "antennas": antennas, "subcarriers": subcarriers, "passes": 2}
    command = [sys.executable, "-m", "chachart.node.commands.benchmarks.footprint"]
    command += ["--theta", method[0], "--rho", method[1]]
    for name, value in options.items():
        command += [f"--{name}", str(value)]
    result: Any = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    return dict(result)


def _cells(found: dict[str, float], ues: int) -> tuple[float, float, float]:
    return found["us"], found["state_bytes"] / ues, found["peak_bytes"] / 1e6
