"""A node as a process of its own, watched from outside: its summary, processor time and peak memory."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from chachart.node.data.errors import SetupError

WATCH_EVERY_S = 0.1
END_WITHIN_S = 60.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a node that has ended said, and what all its processes took of processor time and memory."""

    summary: dict[str, Any]
    cpu_s: float
    peak_bytes: int


@dataclass(frozen=True, slots=True)
class Footprint:
    """What a process holds: memory (its own, resident), open files, threads."""

    bytes: int
    files: int
    threads: int


class RunningNode:
    """Starts `chachart-node` with a configuration; a context manager that leaves no process behind.

    Parameters
    ----------
    directory
        For the configuration, the log and the summary.
    config
        TOML.
    options
        Further options of `chachart-node`.
    """

    def __init__(self, directory: Path, config: str, *options: str) -> None:
        self._summary, self._log = directory / "summary.json", directory / "node.log"
        self._summary.unlink(missing_ok=True)
        (directory / "node.toml").write_text(config)
        self._cpu_before = _children_cpu_s()
        self._peaks: dict[int, int] = {}
        self._done = threading.Event()
        with self._log.open("w") as log:
            command = [sys.executable, "-m", "chachart.node.commands.node"]
            command += ["--config", str(directory / "node.toml"), "--summary", str(self._summary)]
            self._process = subprocess.Popen([*command, *options], stdout=log, stderr=log)
        self._watch = threading.Thread(target=self._look, daemon=True)
        self._watch.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    @property
    def pid(self) -> int:
        """The main process."""
        return self._process.pid

    def rest(self, seconds: float) -> None:
        """Let it run for so long.

        Raises
        ------
        SetupError
            If it has ended meanwhile, with the last line of its log.
        """
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return
        self.outcome(END_WITHIN_S)
        raise SetupError("the node has ended before its time")

    def kill(self) -> None:
        """End the main process at once, with SIGKILL."""
        self._process.kill()
        self._process.wait()
        self._done.set()

    def stop(self) -> Outcome:
        """Ask the node to drain and end."""
        self._process.terminate()
        return self.outcome(END_WITHIN_S)

    def outcome(self, timeout: float) -> Outcome:
        """What the node has to say once it has ended.

        Raises
        ------
        SetupError
            If it ended badly, with the last line of its log.
        """
        status = self._process.wait(timeout)
        self._done.set()
        self._watch.join()
        if status != 0:
            raise SetupError(
                f"the node ended with {status}: {self._log.read_text().strip().splitlines()[-1]}"
            )
        summary = json.loads(self._summary.read_text())
        return Outcome(summary, _children_cpu_s() - self._cpu_before, sum(self._peaks.values()))

    def _look(self) -> None:
        while not self._done.wait(WATCH_EVERY_S):
            for pid in _family(self._process.pid):
                parent = _parent(pid)
                if parent in (self._process.pid, os.getpid()):
                    held = peak_bytes(pid)
                else:  # a worker's writer of snapshots, one at a time: the rest is its worker's
                    pid, held = -parent, private_bytes(pid)
                self._peaks[pid] = max(self._peaks.get(pid, 0), held)


def _children_cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _family(pid: int) -> list[int]:
    """A process and its children's children."""
    children = Path(f"/proc/{pid}/task/{pid}/children")
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        found = [int(child) for task in tasks for child in (task / children.name).read_text().split()]
    except OSError:
        return [pid]
    return [pid, *(member for child in found for member in _family(child))]


def _parent(pid: int) -> int:
    """Of a process; 0 if it is gone."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def children(pid: int) -> dict[str, int]:
    """The node's child processes by what they do: `feeder`, `worker 0`, `worker 1`, ..., `quality`."""
    found: dict[str, int] = {}
    workers = 0
    for child in sorted(_family(pid)[1:]):
        try:
            command = Path(f"/proc/{child}/cmdline").read_bytes().decode().split("\0")
        except OSError:
            continue
        if _parent(child) != pid:  # a worker's writer of snapshots
            continue
        module = next((part.rpartition(".")[2] for part in command if ".runtime." in part), "")
        if module == "worker":
            found[f"worker {workers}"] = child
            workers += 1
        elif module:
            found[module.removesuffix("_watch")] = child
    return found


def footprints(pid: int) -> dict[str, Footprint]:
    """What the node's processes hold, by what they do; the main process is `main`."""
    found = {}
    for name, process in {"main": pid, **children(pid)}.items():
        try:
            files = len(list(Path(f"/proc/{process}/fd").iterdir()))
            threads = len(list(Path(f"/proc/{process}/task").iterdir()))
        except OSError:
            continue
        found[name] = Footprint(private_bytes(process), files, threads)
    return found


def private_bytes(pid: int) -> int:
    """Memory that no other process shares, 0 if it is gone."""
    try:
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return 1024 * sum(int(line.split()[1]) for line in rollup if line.startswith("Private_"))


def peak_bytes(pid: int) -> int:
    """Most memory that a process has had, 0 if it is gone.

    The kernel's resource usage will not do: it begins with what the parent had.
    """
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")), 0)
