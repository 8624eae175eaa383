"""Kills: SIGKILL of any process of a node at random moments, and what the chart is afterwards.

*lossless*: a recording is played round and round; in the end the node's chart must be the one that the
library makes of the same frames, and nothing may be lost. *live*: the simulator does not wait; what could not
be had again must have been counted. The main process is started again with --resume.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import tempfile
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import zmq

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks.kernels import noisy_blocks
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.running import RunningNode, children
from chachart.node.commands.ctl import ask
from chachart.node.commands.shared.cli import progress
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.files.recording import RecordingReader, RecordingWriter

RECOVERED_WITHIN_S = 60.0
MOST_A_MINUTE = 2
"""A third death of feeder or quality process within a minute ends a node, as it should."""
PAUSE_S = (0.2, 2.0)
POLL_S = 0.05
CAPTURE = "capture.mcap"
ROUNDS = 40
"""Frames of each UE in the recording."""
ARRAY = ArraySettings(antennas=16, subcarriers=8, subcarrier_spacing_hz=312_500.0)
STATED = ("ue", "snapshots", "theta", "rho", "theta_std", "rho_std", "x", "y")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench kills`."""
    parser.add_argument("--count", type=int, default=50, help="kills in each run (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=10_000.0, help="frames a second (default: %(default)s)")
    parser.add_argument("--ues", type=int, default=256, help="default: %(default)s")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="default: 1 2")
    parser.add_argument(
        "--stop", type=float, metavar="S", help="stop processes for so many seconds instead of killing them"
    )
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Each kind of source with each number of workers."""
    array = ARRAY.geometry()
    what = "kills" if arguments.stop is None else f"stops for {arguments.stop:g} s"
    table = Table(
        f"{arguments.count} {what} at {arguments.rate:g} frames/s",
        [
            "source",
            "workers",
            "killed",
            "frames in",
            "lost",
            "dropped",
            "state lost",
            "largest difference",
            "longest gap s",
        ],
    )
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory(prefix="chachart-kills-") as name:
        _record(Path(name), array, arguments)
        for source in ("lossless", "live"):
            for workers in arguments.workers:
                with progress(f"{source}, {workers} workers", arguments.count) as done:
                    trial = Trial(Path(name), source, workers, arguments, rng)
                    with trial:
                        for _ in range(arguments.count):
                            trial.kill_one()
                            done(1)
                        difference = trial.settle(array)
                    trial.report(table, difference)
    table.notes.append(
        "lost: frames in that were neither estimated nor counted as dropped; largest difference: relative, "
        "of any number in any row from those of an undisturbed run"
    )
    return [table]


def _record(directory: Path, array: ArrayGeometry, arguments: argparse.Namespace) -> None:
    """A recording in which every UE has as many frames, one after the other at the given rate."""
    with RecordingWriter(directory / CAPTURE, array) as writer:
        for round_ in range(ROUNDS):
            for block in noisy_blocks(array, arguments.ues, 64, seed=round_):
                seq = round_ * arguments.ues + block.seq
                time_ns = 1 + ((seq + np.arange(len(block))) * (1e9 / arguments.rate)).astype(np.int64)
                writer.write(CsiBlock(block.array, seq, block.ue, time_ns, block.csi, block.position))


@dataclass
class Trial:
    """One node that is killed again and again, and started again where it is its main process."""

    directory: Path
    source: str
    workers: int
    arguments: argparse.Namespace
    rng: random.Random
    killed: dict[str, int] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)

    def __enter__(self) -> Self:
        self.folder = self.directory / f"{self.source}-{self.workers}"
        self.folder.mkdir()
        self._recent: dict[str, deque[float]] = {}
        self._gaps = Gaps(f"ipc://{self.folder}/chart")
        self._start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._node.__exit__(kind, error, trace)
        self._gaps.stop()

    def kill_one(self) -> None:
        """Wait a random time, kill a random process, and wait until the chart goes on."""
        self._node.rest(self.rng.uniform(*PAUSE_S))
        processes = {"main": self._node.pid, **children(self._node.pid)}
        name = self.rng.choice([name for name in processes if self._may(name)])
        kind = name.split()[0]
        self.killed[kind] = self.killed.get(kind, 0) + 1
        self._recent.setdefault(kind, deque()).append(time.monotonic())
        if self.arguments.stop is not None:
            self._stop_for(processes[name], self.arguments.stop)
        elif name == "main":
            self._node.kill()
            self._recent.clear()
            self._start()
        else:
            os.kill(processes[name], signal.SIGKILL)
            self._wait_for_frames()

    def _stop_for(self, pid: int, seconds: float) -> None:
        """Stop a process, which the node may end meanwhile, and wait until the chart goes on."""
        os.kill(pid, signal.SIGSTOP)
        self._node.rest(seconds)
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
        self._wait_for_frames()

    def settle(self, array: ArrayGeometry) -> float | None:
        """Let it finish what it has; the largest difference of its chart from an undisturbed run's."""
        difference = None
        if self.source == "lossless":
            self._ask(op="replay", paused=True)
            self._until(lambda status: status["backlog_frames"] == 0 and status["frames_in_per_s"] == 0)
            chart = self._ask(op="chart")
            difference = self._difference(array, chart)
        self.summary = self._node.stop().summary
        return difference

    def report(self, table: Table, difference: float | None) -> None:
        """One row."""
        summary = self.summary
        dropped = sum(summary["dropped"].values())
        table.add(
            self.source,
            self.workers,
            ", ".join(f"{n} {kind}" for kind, n in sorted(self.killed.items())),
            summary["frames_in"],
            summary["frames_in"] - summary["frames_estimated"] - dropped,
            dropped,
            summary["state_lost"],
            None if difference is None else f"{difference:.1e}",
            self._gaps.longest_s,
        )

    def _may(self, name: str) -> bool:
        kind, now = name.split()[0], time.monotonic()
        recent = self._recent.get(kind, deque())
        while recent and recent[0] < now - 60:
            recent.popleft()
        return kind not in ("feeder", "quality") or len(recent) < MOST_A_MINUTE

    def _start(self) -> None:
        self._node = RunningNode(self.folder, self._config(), "--resume")
        self._wait_for_frames()

    def _wait_for_frames(self) -> None:
        before: list[int] = []

        def moving(status: dict[str, Any]) -> bool:
            if status["state"] == "starting":
                return False
            before.append(status["frames_estimated"])
            return before[-1] > before[0]

        self._until(moving)

    def _until(self, condition: Any) -> None:
        deadline = time.monotonic() + RECOVERED_WITHIN_S
        while True:
            try:
                if condition(self._ask(op="status")):
                    return
            except SetupError:
                pass
            if time.monotonic() > deadline:
                raise SetupError(f"the node did not recover within {RECOVERED_WITHIN_S:g} s: {self.folder}")
            self._node.rest(POLL_S)

    def _ask(self, **request: Any) -> dict[str, Any]:
        return ask(f"ipc://{self.folder}/control", request, 2.0)

    def _difference(self, array: ArrayGeometry, chart: dict[str, Any]) -> float:
        """From what the library makes of the first frames of the recording, as many as came in."""
        frames = self._ask(op="status")["frames_in"]
        once = CsiBlock.concatenate(list(RecordingReader(self.directory / CAPTURE).blocks()))
        estimator = ChartEstimator(array, averaging="mean")
        rows = estimator.update(once.cut(0, min(len(once), frames)))
        for start in range(len(once), frames, len(once)):
            update = estimator.update(once.cut(0, min(len(once), frames - start)))
            rows = ChartUpdate.concatenate([rows, update])
        order, mine = np.argsort(rows.ue), np.argsort(np.array(chart["ue"], np.uint64))
        worst = 0.0
        for name in STATED:
            wanted = getattr(rows, name)[order].astype(np.float64)
            there = np.array([np.nan if v is None else v for v in chart[name]], np.float64)[mine]
            scale = np.maximum(np.abs(wanted), 1e-9)
            worst = max(worst, float(np.nanmax(np.abs(there - wanted) / scale)))
        return worst

    def _config(self) -> str:
        arguments = self.arguments
        source = f"""
[source]
type = "recording"
path = "{self.directory / CAPTURE}"
loops = 0
"""
        if self.source == "live":
            source = f"""
[array]
antennas = {ARRAY.antennas}
subcarriers = {ARRAY.subcarriers}
subcarrier_spacing_hz = {ARRAY.subcarrier_spacing_hz}
[source]
type = "simulator"
layout = "uniform"
ues = {arguments.ues}
frame_rate_hz = {arguments.rate}
"""
        return f"""
{source}
[estimator]
averaging = "mean"
[workers]
count = {self.workers}
[quality]
every_s = 1.0
[state]
directory = "{self.folder}/state"
every_s = 1.0
[[sinks]]
type = "control"
endpoint = "ipc://{self.folder}/control"
[[sinks]]
type = "publisher"
endpoint = "ipc://{self.folder}/chart"
"""


class Gaps:
    """Listens to a node's charts, and notes the longest time without one."""

    def __init__(self, endpoint: str) -> None:
        self.longest_s = 0.0
        self._endpoint = endpoint
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Listen no more."""
        self._stopping.set()
        self._thread.join()

    def _listen(self) -> None:
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.connect(self._endpoint)
            socket.subscribe(b"chart.")
            last: float | None = None
            while not self._stopping.is_set():
                if socket.poll(100):
                    socket.recv_multipart()
                    now = time.monotonic()
                    if last is not None:
                        self.longest_s = max(self.longest_s, now - last)
                    last = now
