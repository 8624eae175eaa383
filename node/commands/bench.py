"""Measure how fast this machine runs chachart: tables for people, --json for machines.

Medians of repeated runs, with the least and the most in parentheses. Every process has one BLAS thread.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

BENCHMARKS = {
    "kernels": "each estimator, and each pair of estimators, beside a textbook implementation",
    "arrays": "boards, circles and elements in space: speed, and errors over the Cramér-Rao bound",
    "fusion": "positions a second from four boards round a hall",
    "pipeline": "a whole node: frames a second, latency, processor time, memory",
    "quality": "trustworthiness and continuity, exact and sampled, beside scikit-learn",
    "frontends": "packet decoders, and whole serial and CAN links, with damage and without",
    "formats": "captures of Wi-Fi tools: read and decoded, megabytes a second",
    "attack": "mutated inputs to every decoder, floods on every socket of a running node",
    "damage": "mutated captures of every format: frames or a clean error, whatever the bytes",
    "flow": "recordings, the wire and the sinks by themselves",
    "scale": "more UEs, antennas and subcarriers: time a frame and memory",
    "snapshots": "how long a snapshot holds up estimates, and what snapshots cost",
    "soak": "hours of running: how memory, open files and threads grow",
    "kills": "kill -9 of any process at any moment: what the chart is afterwards",
    "tracks": "UEs that move: the live track beside averages over fixed numbers of frames",
    "truth": "errors beside the deviations told, with echoes and without a direct path, over several draws",
    "view": "what the live view costs a node, without and with a viewer",
}
"""Each benchmark and what it measures; its module in `benchmarks` has `add_arguments` and `run`."""

ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench`."""
    benchmarks = parser.add_subparsers(metavar="BENCHMARK", required=True, dest="benchmark")
    for name, purpose in BENCHMARKS.items():
        subparser = benchmarks.add_parser(name, help=purpose, description=purpose)
        subparser.add_argument("--json", type=Path, metavar="FILE", help="write the results there too")
        _module(name).add_arguments(subparser)


def run(arguments: argparse.Namespace) -> int:
    """Run one benchmark, print its tables, and return the exit status."""
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        # BLAS reads these when it is loaded, which has happened by now: start over with them set.
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | ONE_THREAD)
    from rich.console import Console

    from chachart.node.commands.benchmarks import machine

    console = Console(width=None if sys.stdout.isatty() else 140)
    about = machine.describe()
    console.print("; ".join(f"{name} {value}" for name, value in about.items()), highlight=False)
    tables = _module(arguments.benchmark).run(arguments)
    for table in tables:
        table.show(console)
    if arguments.json is not None:
        result = {
            "benchmark": arguments.benchmark,
            "machine": about,
            "tables": [table.as_dict() for table in tables],
        }
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


def _module(name: str) -> Any:
    return import_module(f"chachart.node.commands.benchmarks.{name}")
