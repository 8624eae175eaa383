"""View: what the live view costs a node that plays a recording as fast as it can, viewer or none."""

from __future__ import annotations

import argparse
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks import pipeline
from chachart.node.commands.benchmarks.kernels import noisy_blocks
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.running import Outcome, RunningNode
from chachart.node.commands.benchmarks.timing import Timing
from chachart.node.commands.shared.cli import progress

CASES = {"no view": (False, 0), "a view, nobody looks": (True, 0), "one viewer": (True, 1)}
TRY_EVERY_S = 0.05
OPEN_WITHIN_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench view`."""
    pipeline.add_arguments(parser)
    parser.add_argument("--port", type=int, default=18080, help="for the view (default: %(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Run the cases in turn, `--runs` times each."""
    array = ArraySettings(subcarrier_spacing_hz=312500.0).geometry()
    runs: dict[str, list[Outcome]] = {case: [] for case in CASES}
    seen: list[int] = []
    with tempfile.TemporaryDirectory(prefix="chachart-bench-") as name:
        directory = Path(name)
        loops = pipeline.record(directory, array, noisy_blocks(array, arguments.ues, 64), arguments.frames)
        base = pipeline.recording_config(directory, arguments, arguments.workers[0], loops)
        sink = f'[[sinks]]\ntype = "view"\nport = {arguments.port}\nrecord_folder = "{directory}"\n'
        with progress("full speed", len(CASES) * arguments.runs) as done:
            for _ in range(arguments.runs):
                for case, (view, viewers) in CASES.items():
                    config = (sink if view else "") + base
                    with RunningNode(directory, config) as node, _looking(arguments.port, viewers, seen):
                        runs[case].append(node.outcome(pipeline.RUN_WITHIN_S))
                    done(1)
    table = Table(
        f"the live view beside a recording of {arguments.ues} UEs at full speed",
        ["", "frames/s", "of no view", "CPU s per 1000 frames, start included"],
    )
    rates = {
        case: Timing.of([r.summary["frames_in"] / r.summary["seconds"] for r in runs[case]]) for case in CASES
    }
    for case, rate in rates.items():
        cpu = Timing.of([r.cpu_s / r.summary["frames_in"] * 1000 for r in runs[case]])
        table.add(case, rate, f"{rate.median / rates['no view'].median:.1%}", cpu)
    table.notes = [f"the viewer got {sum(seen) / max(len(seen), 1):,.0f} messages a run"]
    return [table]


@contextmanager
def _looking(port: int, viewers: int, seen: list[int]) -> Iterator[None]:
    """Viewers that read all they get, for as long as the node is there."""
    stop = threading.Event()
    threads = [threading.Thread(target=_look, args=(port, stop, seen)) for _ in range(viewers)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def _look(port: int, stop: threading.Event, seen: list[int]) -> None:
    while not stop.is_set():
        try:
            with connect(f"ws://127.0.0.1:{port}/ws", open_timeout=OPEN_WITHIN_S, max_size=None) as socket:
                seen.append(0)
                for _ in socket:
                    seen[-1] += 1
        except (OSError, TimeoutError, ConnectionClosed):
            stop.wait(TRY_EVERY_S)
