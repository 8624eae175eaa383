"""Soak: a node that runs for hours, and how memory, open files and threads of its processes grow meanwhile.

The simulated world keeps a frame rate; every sink that a lab has is there. Growth is the slope of a line
through the samples after the first tenth, in which caches fill; what is bounded stops growing at some time,
and shows no slope in the last third.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.running import Footprint, RunningNode, footprints
from chachart.node.commands.shared.cli import progress

SAMPLES = 360
WARM_UP_SHARE = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench soak`."""
    parser.add_argument("--hours", type=float, default=1.0, help="default: %(default)s")
    parser.add_argument("--rate", type=float, default=4000.0, help="frames a second (default: %(default)s)")
    parser.add_argument("--ues", type=int, default=512, help="default: %(default)s")
    parser.add_argument("--workers", type=int, default=1, help="default: %(default)s")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Let it run, and look now and then."""
    every_s = arguments.hours * 3600 / SAMPLES
    samples: list[dict[str, Footprint]] = []
    with tempfile.TemporaryDirectory(prefix="chachart-soak-") as name:
        directory = Path(name)
        with RunningNode(directory, _config(directory, arguments)) as node:
            with progress(f"{arguments.hours:g} h", SAMPLES) as done:
                for _ in range(SAMPLES):
                    node.rest(every_s)
                    samples.append(footprints(node.pid))
                    done(1)
            summary = node.stop().summary
    table = Table(
        f"{arguments.hours:g} h at {arguments.rate:g} frames/s, {arguments.ues} UEs",
        [
            "process",
            "MB at first",
            "MB at last",
            "MB an hour",
            "in the last third",
            "files",
            "files an hour",
            "threads",
            "threads an hour",
        ],
    )
    kept = samples[int(len(samples) * WARM_UP_SHARE) :]
    hours = np.arange(len(kept)) * every_s / 3600
    last = 2 * len(kept) // 3
    for process in sorted(set.intersection(*(set(sample) for sample in kept))):
        found = [sample[process] for sample in kept]
        megabytes = [one.bytes / 1e6 for one in found]
        table.add(
            process,
            float(megabytes[0]),
            float(megabytes[-1]),
            _slope(hours, megabytes),
            _slope(hours[last:], megabytes[last:]),
            found[-1].files,
            _slope(hours, [one.files for one in found]),
            found[-1].threads,
            _slope(hours, [one.threads for one in found]),
        )
    lost = sum(summary["dropped"].values())
    table.notes.append(
        f"{summary['frames_in']:,} frames in, {summary['frames_estimated']:,} estimated, {lost:,} dropped, "
        f"{summary['worker_restarts']} restarts"
    )
    return [table]


def _slope(hours: NDArray[np.float64], values: Sequence[float]) -> float:
    return float(np.polyfit(hours, values, 1)[0])


def _config(directory: Path, arguments: argparse.Namespace) -> str:
    return f"""
[array]
antennas = 16
subcarriers = 16
subcarrier_spacing_hz = 312500.0
[source]
type = "simulator"
layout = "uniform"
ues = {arguments.ues}
frame_rate_hz = {arguments.rate}
[workers]
count = {arguments.workers}
[state]
directory = "{directory}/state"
[[sinks]]
type = "view"
port = 0
[[sinks]]
type = "control"
endpoint = "ipc://{directory}/control"
[[sinks]]
type = "publisher"
endpoint = "ipc://{directory}/chart"
[[sinks]]
type = "chart_log"
path = "{directory}/chart.mcap"
every_s = 60.0
[[sinks]]
type = "quality_log"
path = "{directory}/quality.jsonl"
"""
