"""Snapshots: for how long one holds up a worker's estimates, how long it takes, and what they cost in all.

A worker writes its snapshot in a forked process: what holds up its estimates is the fork, and the copying of
memory that is written to meanwhile. Throughput is that of a recording played as fast as the node can, with
snapshots and without in turn.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks.kernels import noisy_blocks
from chachart.node.commands.benchmarks.pipeline import RUN_WITHIN_S, record, recording_config
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.running import RunningNode
from chachart.node.commands.benchmarks.timing import Timing
from chachart.node.commands.shared.cli import progress
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.folders import LocalFolder
from chachart.node.runtime.processor import BlockProcessor, FrameClock
from chachart.node.runtime.worker_state import Done, WorkerState

BLOCK = 64
PAIRS = (("bartlett", "bartlett"), ("music", "music"), ("joint", "joint"))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench snapshots`."""
    parser.add_argument("--ues", type=int, default=100_000, help="default: %(default)s")
    parser.add_argument("--frames", type=int, default=200_000, help="frames a run (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--every-s", type=float, default=1.0, help="default: %(default)s")
    parser.add_argument("--runs", type=int, default=3, help="timed runs (default: %(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """One snapshot of many UEs by each pair of methods, then throughput."""
    array = ArraySettings(subcarrier_spacing_hz=312500.0).geometry()
    with tempfile.TemporaryDirectory(prefix="chachart-bench-") as name:
        return [_pauses(arguments, Path(name), array), _throughput(arguments, Path(name), array)]


def _pauses(arguments: argparse.Namespace, directory: Path, array: ArrayGeometry) -> Table:
    table = Table(
        f"a snapshot of {arguments.ues:,} UEs, {array.antennas} x {array.subcarriers}",
        [
            "theta / rho",
            "MB",
            "written in s",
            "fork ms",
            "slowest block before ms",
            "slowest block meanwhile ms",
        ],
    )
    frames = noisy_blocks(array, BLOCK, BLOCK)[0]
    for theta, rho in PAIRS:
        processor = BlockProcessor(
            array, {"max_ues": arguments.ues, "theta": theta, "rho": rho}, FrameClock(live=False)
        )

        def estimate(
            start: int, processor: BlockProcessor = processor, pair: tuple[str, str] = (theta, rho)
        ) -> float:
            ue = (start + np.arange(BLOCK, dtype=np.uint64)) % np.uint64(arguments.ues)
            begin = time.perf_counter()
            processor.process(CsiBlock(array.name, start, ue, frames.time_ns, frames.csi), *pair)
            return time.perf_counter() - begin

        for start in range(0, arguments.ues, BLOCK):
            estimate(start)
        before = max(estimate(n * BLOCK) for n in range(100))
        state = WorkerState(LocalFolder(directory), 0, 1, durable=True)
        begin = time.perf_counter()
        state.begin(processor, Done(seq=1))
        fork_s, meanwhile, n = time.perf_counter() - begin, 0.0, 0
        while state.writing:
            meanwhile, n = max(meanwhile, estimate(n * BLOCK)), n + 1
            state.wait()
        seconds = time.perf_counter() - begin
        [path] = directory.glob("worker-0-of-1-*.snapshot")
        table.add(
            f"{theta} / {rho}",
            path.stat().st_size / 1e6,
            seconds,
            fork_s * 1e3,
            before * 1e3,
            meanwhile * 1e3,
        )
        path.unlink()
    return table


def _throughput(arguments: argparse.Namespace, directory: Path, array: ArrayGeometry) -> Table:
    table = Table(
        f"a recording at full speed, 2048 UEs, {arguments.workers} workers",
        ["snapshots", "frames/s"],
    )
    options = argparse.Namespace(theta="bartlett", rho="bartlett")
    loops = record(directory, array, noisy_blocks(array, 2048, BLOCK), arguments.frames)
    config = recording_config(directory, options, arguments.workers, loops)
    rates: dict[float, list[float]] = {0.0: [], arguments.every_s: []}
    with progress("full speed", 2 * arguments.runs) as done:
        for _ in range(arguments.runs):
            for every_s, found in rates.items():
                with RunningNode(directory, f"{config}\n[state]\nevery_s = {every_s}\n") as node:
                    summary = node.outcome(RUN_WITHIN_S).summary
                found.append(summary["frames_estimated"] / summary["seconds"])
                done(1)
    for every_s, found in rates.items():
        table.add(f"every {every_s:g} s" if every_s else "none", Timing.of(found))
    share = np.median(rates[arguments.every_s]) / np.median(rates[0.0])
    table.notes.append(
        f"with snapshots {100 * share:.1f} % of without (medians of {arguments.runs} runs in turn)"
    )
    return table
