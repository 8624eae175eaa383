"""A node as a process of its own, watched from outside: its summary, processor time and peak memory."""

from __future__ import annotations

import json
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


class RunningNode:
    """Starts `chachart-node` with a configuration; a context manager that leaves no process behind.

    Parameters
    ----------
    directory
        For the configuration, the log and the summary.
    config
        TOML.
    """

    def __init__(self, directory: Path, config: str) -> None:
        self._summary, self._log = directory / "summary.json", directory / "node.log"
        self._summary.unlink(missing_ok=True)
        (directory / "node.toml").write_text(config)
        self._cpu_before = _children_cpu_s()
        self._peaks: dict[int, int] = {}
        self._done = threading.Event()
        with self._log.open("w") as log:
            command = [sys.executable, "-m", "chachart.node.commands.node"]
            command += ["--config", str(directory / "node.toml"), "--summary", str(self._summary)]
            self._process = subprocess.Popen(command, stdout=log, stderr=log)
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
                self._peaks[pid] = max(self._peaks.get(pid, 0), peak_bytes(pid))


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


def peak_bytes(pid: int) -> int:
    """Most memory that a process has had, 0 if it is gone.

    The kernel's resource usage will not do: it begins with what the parent had.
    """
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")), 0)
