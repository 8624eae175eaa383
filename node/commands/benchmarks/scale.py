"""Scale: time a frame and memory with more UEs, more antennas, more subcarriers; each in a fresh process.

With --simulate, what numbers of UEs take that no machine at hand has: computed from what this one was
measured to need for one frame, one UE and one row.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from typing import Any, get_args

from chachart.node.commands.benchmarks import simulate
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.shared.cli import progress
from chachart.node.data.methods import RhoMethod, ThetaMethod

UES = (1_000, 10_000, 100_000, 1_000_000)
SIZES = ((8, 32), (16, 32), (32, 32), (64, 32), (128, 32), (32, 1), (32, 8), (32, 64), (32, 128), (128, 128))
SIZE_UES = 1024
COLUMNS = ["us a frame", "state bytes a UE", "peak MB"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench scale`."""
    parser.add_argument(
        "--max-ues", type=int, default=100_000, help="largest number of UEs (default: %(default)s)"
    )
    parser.add_argument("--theta", default="bartlett", choices=get_args(ThetaMethod))
    parser.add_argument("--rho", default="bartlett", choices=get_args(RhoMethod))
    simulate.add_arguments(parser)


def run(arguments: argparse.Namespace) -> list[Table]:
    """Measure every size in turn, or what is needed to simulate."""
    if arguments.simulate is not None:
        return simulate.run(arguments, footprint)
    method = (arguments.theta, arguments.rho)
    ues = [n for n in UES if n <= arguments.max_ues]
    by_ues = Table(f"UEs of 32 x 32, {' / '.join(method)}", ["UEs", *COLUMNS])
    by_size = Table(f"array sizes, {SIZE_UES} UEs", ["antennas x subcarriers", "theta / rho", *COLUMNS])
    with progress("measuring", len(ues) + len(SIZES)) as done:
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
    return [by_ues, by_size]


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
