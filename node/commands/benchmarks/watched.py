"""A node at full speed, watched from outside: frames a second, and what its threads spend on each."""

from __future__ import annotations

import threading
import time
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from chachart.node.commands.benchmarks.pipeline import CAPTURE
from chachart.node.commands.benchmarks.running import RunningNode, children
from chachart.node.commands.ctl import ask
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingWriter
from chachart.node.net.client import subscribe

WARM_UP_ROUNDS = 3
START_WITHIN_S = 60.0
POLL_S = 0.02
LISTEN_S = 0.2

Threads = dict[tuple[str, str], float]
"""Processor time by process and thread."""


@dataclass(frozen=True, slots=True)
class Watched:
    """What was seen.

    Attributes
    ----------
    frames_per_s
        Estimated.
    threads
        Microseconds a frame.
    subscriber
        Microseconds a row of who subscribes to all of them.
    """

    frames_per_s: float
    threads: Threads
    subscriber: float

    def spent(self, process: str, *names: str) -> float:
        """Microseconds a frame of all processes whose name begins so, in threads of these names or in all."""
        return sum(
            us
            for (at, thread), us in self.threads.items()
            if at.startswith(process) and (not names or thread in names)
        )

    def share(self, us: float) -> float:
        """Of a core, of what takes so many microseconds a frame."""
        return self.frames_per_s * us * 1e-6


def watch(
    directory: Path,
    array: ArrayGeometry,
    blocks: list[CsiBlock],
    seconds: float,
    method: tuple[str, str],
    workers: int = 1,
) -> Watched:
    """Let a node play `blocks` again and again, published to one subscriber.

    Raises
    ------
    SetupError
        If the node does not run, or nothing comes out of it.
    """
    with RecordingWriter(directory / CAPTURE, array) as writer:
        for block in blocks:
            writer.write(block)
    ues = sum(len(block) for block in blocks)
    heard, stop = Counter[str](), threading.Event()
    listener = threading.Thread(target=_listen, args=(f"ipc://{directory}/charts", heard, stop))
    with RunningNode(directory, _config(directory, ues, method, workers)) as node:
        listener.start()
        try:
            first = _more_than(node, directory, WARM_UP_ROUNDS * ues)
            began, before = time.monotonic(), thread_times(node.pid)
            node.rest(seconds)
            frames = _more_than(node, directory, _estimated(directory)) - first
            took, after = time.monotonic() - began, thread_times(node.pid)
        finally:
            stop.set()
            listener.join()
    if not heard["rows"]:
        raise SetupError("the node published no row")
    spent = {key: (total - before.get(key, 0.0)) / frames * 1e6 for key, total in after.items()}
    return Watched(frames / took, spent, heard["ns"] / heard["rows"] / 1e3)


def thread_times(pid: int) -> Threads:
    """Processor time so far, in seconds, of a node's threads; ZeroMQ's are `io`, nameless ones `other`."""
    found: Threads = defaultdict(float)
    for process, at in {"main": pid, **children(pid)}.items():
        comm = Path(f"/proc/{at}/comm").read_text()
        for task in Path(f"/proc/{at}/task").iterdir():
            with suppress(OSError):
                name = (task / "comm").read_text().strip()
                spent_ns = int((task / "schedstat").read_text().split()[0])
                if task.name == str(at):
                    name = "main"
                elif name.startswith("ZMQ"):
                    name = "io"
                elif name == comm.strip():
                    name = "other"
                found[process, name] += spent_ns / 1e9
    return found


def _listen(endpoint: str, heard: Counter[str], stop: threading.Event) -> None:
    with subscribe(endpoint, timeout=LISTEN_S) as charts:
        while not stop.is_set():
            with suppress(TimeoutError):
                update = next(iter(charts))
                heard["rows"] += len(update)
                heard["ns"] = time.thread_time_ns()


def _config(directory: Path, ues: int, method: tuple[str, str], workers: int) -> str:
    return f"""
[array]
subcarrier_spacing_hz = 312500.0
[source]
type = "recording"
path = "{directory / CAPTURE}"
speed = 0
loops = 0
[estimator]
theta = "{method[0]}"
rho = "{method[1]}"
max_ues = {ues}
[workers]
count = {workers}
[quality]
every_s = 3600
[[sinks]]
type = "publisher"
endpoint = "ipc://{directory}/charts"
[[sinks]]
type = "control"
endpoint = "ipc://{directory}/control"
"""


def _more_than(node: RunningNode, directory: Path, frames: int) -> int:
    """Wait until more frames are estimated, and give how many: the node counts anew twice a second."""
    deadline = time.monotonic() + START_WITHIN_S
    while True:
        with suppress(SetupError):
            if (estimated := _estimated(directory)) > frames:
                return estimated
        if time.monotonic() > deadline:
            raise SetupError(
                f"the node did not estimate more than {frames} frames within {START_WITHIN_S:g} s"
            )
        node.rest(POLL_S)


def _estimated(directory: Path) -> int:
    return int(ask(f"ipc://{directory}/control", {"op": "status"}, 2.0)["frames_estimated"])
