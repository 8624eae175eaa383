"""The feeder as the main process sees it: how it is, what it counts, and what its successor has to know."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from chachart.node.data.counters import Counters
from chachart.node.runtime.child import Child
from chachart.node.runtime.core_time import CoreTime
from chachart.node.runtime.deadlines import LEAST_S, Patience
from chachart.node.runtime.feeder import START_OVER
from chachart.node.runtime.reader import read_tally
from chachart.node.runtime.supervisor import SupervisedChild

log = logging.getLogger(__name__)

MOST_DEATHS = 3
READER_WITHIN_S = 30.0
_COUNTS = (
    "blocks_in",
    "frames_in",
    "frames_estimated",
    "dropped",
    "dropped_here",
    "rejected",
    "gaps",
    "out_of_order",
    "restamped",
)
_PER_LIFE = ("state_lost", "ues_reset", "frames_replayed")
"""Counts of workers that a feeder begins anew."""


class FeederProcess:
    """One feeder, and the one after it if it dies. One thread calls everything.

    Parameters
    ----------
    start
        Starts the process, given the last status of the one before (None if there was none).
    tally
        Where the process counts the frames that come in, so that none is forgotten when it is killed.
    died
        Called when it has died, before its successor starts.

    Attributes
    ----------
    supervised
        The process.
    status
        What it said of itself last; {} before that.
    ready, started
        Whether source and sinks are open, and whether frames are read.
    stuck
        That it hangs, until another one reads; or None.
    """

    def __init__(
        self, start: Callable[[dict[str, Any] | None], Child], tally: Path, died: Callable[[], None]
    ) -> None:
        self.status: dict[str, Any] = {}
        self.ready = self.started = False
        self.stuck: str | None = None
        self.supervised = SupervisedChild(
            "the feeder process", self._start, self._bury, MOST_DEATHS, starts_over=START_OVER
        )
        self._start_process = start
        self._died = died
        self._tally = tally
        self._earlier: Counters = Counters()
        self._heard_at = 0.0
        self._patience = Patience()
        self._core_time = CoreTime()

    def resume(self, status: dict[str, Any]) -> None:
        """Before the first start: the last status of another run."""
        self.status = status
        self._earlier.merge(status.get("earlier", {}))
        self._retire()

    def heard(self, status: dict[str, Any] | None = None) -> None:
        """It has said something, possibly how it is."""
        self._heard_at = time.monotonic()
        if status is not None:
            if self.status and not self.started:  # it does not know yet where its predecessor was
                status = {**status, **{count: self.status[count] for count in _COUNTS}}
            self.status = {**status, "earlier": self._earlier.as_dict()}

    def check(self) -> str | None:
        """Look after the process; gives a reason to give up, if there is one."""
        child = self.supervised.child
        if child is not None and self.started and (reason := self._hangs(child.pid)) is not None:
            log.error("the feeder process (process %d) hangs: %s", child.pid, reason)
            self.stuck = f"the feeder process hangs: {reason}"
            self.started = False
            child.kill()
        return self.supervised.check()

    @property
    def pid(self) -> int | None:
        """Its process id, None while there is none that reads."""
        child = self.supervised.child
        return None if child is None or not self.ready else child.pid

    def reads(self) -> None:
        """It has begun to read."""
        self.started, self.stuck = True, None

    def total(self, count: str) -> int:
        """A count over all workers and all feeders of this run."""
        now: int = sum(worker.get(count, 0) for worker in self.status.get("workers", ()))
        return now + self._earlier.as_dict().get(count, 0)

    def abandon(self) -> None:
        """End it; what is not accounted for counts as dropped."""
        if fed := self.status:
            lost = fed["frames_in"] - fed["frames_estimated"] - sum(fed["dropped"].values())
            fed["dropped"] = {**fed["dropped"], "node_failed": lost}
        self.supervised.kill()

    def _hangs(self, pid: int) -> str | None:
        waited_s = self._core_time.waited_s(pid)
        silent = self._patience.overdue_s(time.monotonic(), self._heard_at, waited_s)
        if silent > LEAST_S:
            return f"not heard of for {silent:.0f} s"
        status = self.status
        if status.get("ended") or any(w.get("backlog_blocks") for w in status.get("workers", ())):
            return None
        silent = status.get("source_silent_s", 0.0)
        return f"its source gave nothing back for {silent:.0f} s" if silent > READER_WITHIN_S else None

    def _start(self) -> Child:
        self._heard_at = time.monotonic()
        return self._start_process(self.status or None)

    def _bury(self, pid: int) -> None:
        self._core_time.forget(pid)
        self._died()
        if self.status:
            self.status["frames_in"] = max(self.status["frames_in"], read_tally(self._tally))
        self._retire()
        self.ready = self.started = False

    def _retire(self) -> None:
        """Keep what it counted and its successor begins anew."""
        workers = self.status.get("workers", ())
        for count in _PER_LIFE:
            self._earlier.add(count, sum(worker.get(count, 0) for worker in workers))
        if self.status:
            self.status = {**self.status, "workers": [], "earlier": self._earlier.as_dict()}
