"""Since when a process could have worked: time in which it waited for a core does not count against it."""

from __future__ import annotations

import time
from pathlib import Path


class CoreTime:
    """Follows the main threads of processes through /proc, to tell slow ones from those that hang.

    One that is stopped or deadlocked waits for no core. A process that is runnable when it is looked at is
    taken to have been so since the last look: the kernel counts a wait when it is over.
    """

    def __init__(self) -> None:
        self._last: dict[int, tuple[float, int, int]] = {}
        self._waited: dict[int, float] = {}

    def waited_s(self, pid: int) -> float:
        """For how many seconds, since this was first asked, the process has waited for a core."""
        now = time.monotonic()
        try:
            ran, waited = (int(field) for field in Path(f"/proc/{pid}/schedstat").read_text().split()[:2])
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (OSError, ValueError):  # it is gone, or the kernel does not count
            return self._waited.get(pid, 0.0)
        then, ran_then, waited_then = self._last.get(pid, (now, ran, waited))
        passed, ran_s, waited_s = now - then, (ran - ran_then) / 1e9, (waited - waited_then) / 1e9
        if state == "R":  # what it waits for now is not in the count before it gets it
            waited_s = max(waited_s, passed - ran_s)
        self._last[pid] = now, ran, waited
        self._waited[pid] = self._waited.get(pid, 0.0) + min(max(waited_s, 0.0), passed)
        return self._waited[pid]

    def forget(self, pid: int) -> None:
        """It is gone."""
        self._last.pop(pid, None)
        self._waited.pop(pid, None)
