"""A running node: its processes, and the loop in the main process that ties everything together."""

from __future__ import annotations

import logging
import threading
import time
from functools import partial
from typing import Any

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.runtime import messages
from chachart.node.runtime.child import Child
from chachart.node.runtime.collector import Collector
from chachart.node.runtime.feeder import START_OVER
from chachart.node.runtime.feeder_process import FeederProcess
from chachart.node.runtime.launch import Launcher
from chachart.node.runtime.links import Links
from chachart.node.runtime.node_state import NodeState
from chachart.node.runtime.notify import Notifier
from chachart.node.runtime.panel import words
from chachart.node.runtime.plan import Plan
from chachart.node.runtime.quality_watch import QualityWatch
from chachart.node.runtime.report import Reporter
from chachart.node.runtime.requests import PendingRequests, chart_columns, checked_method, ue_list
from chachart.node.runtime.source_processes import SourceProcesses
from chachart.node.runtime.status import NodeStatus, summary
from chachart.node.runtime.supervisor import SupervisedChild, Supervisor
from chachart.node.runtime.thread_names import show_name
from chachart.sinks.base import NodeAccess

log = logging.getLogger(__name__)

DRAIN_WITHIN_S = 10.0
START_WITHIN_S = 60.0
LOOP_S = 0.05
STATUS_EVERY_S = 0.5
CLOSE_WITHIN_S = 5.0
WORKERS_CLOSE_WITHIN_S = 2.0


class Node(NodeAccess):
    """Runs a plan: `start`, then `wait` until it has ended (or `stop` it), then `close`.

    It is also the `NodeAccess` that sinks get.

    Attributes
    ----------
    failure
        Why the node ended before its time, or None.
    closed
        Whether nothing of it is left.
    """

    def __init__(self, plan: Plan, log_level: int = logging.INFO) -> None:
        self.failure: str | None = None
        self._plan = plan
        self._links = Links()
        try:
            self._kept = NodeState(plan, self._links.directory, self._facts)
            self._launch = Launcher(plan, self._links, log_level, self._kept.folder)
        except SetupError:
            self._links.close()
            raise
        self._collector = Collector(plan.estimator, plan.alerts, plan.zones)
        report, endpoint = partial(self._collector.report, "quality"), self._links.endpoints["quality"]
        self._quality = QualityWatch(plan.quality, self.chart, report, self._launch.quality, endpoint)
        self._pending = PendingRequests(lambda values: self._links.command(messages.REQUEST, values))
        self._workers = Supervisor(
            SupervisedChild(f"worker {s}", partial(self._launch.worker, s), partial(self._worker_died, s))
            for s in range(plan.workers.count)
        )
        self._sources = SourceProcesses(plan, self._launch.source)
        self._children = Supervisor([*self._workers.children, *self._sources.children])
        self._feeder = FeederProcess(self._start_feeder, self._launch.tally, self._feeder_died)
        parts = self._collector, self._feeder, self._workers, self._sources, self._quality
        self._reporter = Reporter(plan, *parts)
        self._method: dict[str, str] = {"theta": plan.estimator.theta, "rho": plan.estimator.rho}
        self._state = "starting"
        self._notifier = Notifier()
        self._status: dict[str, Any] = NodeStatus(array=plan.array.name).as_dict()
        self._started_at: float | None = None
        self._seconds = self._earlier_s = 0.0
        self.closed = False
        self._give_up_at: float | None = None
        self._setup_error: str | None = None
        self._ready = threading.Event()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._run, name="node", daemon=True)

    def start(self) -> None:
        """Start the processes, open source and sinks, and begin to read.

        Raises
        ------
        SetupError
            If something the plan asks for cannot be; everything is closed again then.
        """
        try:
            self._resume()
            self._feeder.check()
            self._children.check()
            self._collector.open_sinks(self._plan, self)
            self._thread.start()
            if not self._ready.wait(START_WITHIN_S):
                raise SetupError(f"{self._plan.sources} did not open within {START_WITHIN_S:.0f} s")
            if self._setup_error is not None:
                raise SetupError(self._setup_error)
            self._links.command(messages.GO, {})
            self._kept.start()
            self._quality.start()
        except SetupError:
            self._finished.set()
            self.kill()
            self._close_parts()
            raise

    def stop(self, within_s: float = DRAIN_WITHIN_S) -> None:
        """Read no further and drain; what is left after `within_s` seconds is dropped and counted."""
        if self._give_up_at is None:
            self._state = "draining"
            self._notifier.stopping()
            self._give_up_at = time.monotonic() + within_s + CLOSE_WITHIN_S
            self._links.command(messages.STOP, {"within_s": within_s})

    def wait(self, timeout: float) -> bool:
        """Whether the node has drained within `timeout` seconds."""
        return self._finished.wait(timeout)

    @property
    def feeder_pid(self) -> int | None:
        """Process id of the feeder."""
        return self._feeder.pid

    def addresses(self) -> list[tuple[str, str]]:
        """Where a person finds what the chart's sinks give, by sink."""
        return self._collector.addresses()

    def kill(self) -> None:
        """End all child processes at once; a node that is killed leaves no summary."""
        self._children.kill()
        self._quality.kill()
        self._feeder.supervised.kill()
        self._links.remove_directory()

    def close(self) -> dict[str, Any]:
        """After `wait` said so: close everything; gives the summary."""
        self._thread.join()
        self._quality.finish()
        self._state = "stopped"
        self._update_status()
        self._collector.report("status", self._status)
        self._close_parts()
        self._update_status()
        return summary(self._status, self._collector.latency.percentiles_ms())

    def chart(self) -> ChartUpdate | None:
        return self._collector.table.chart()

    def status(self) -> dict[str, Any]:
        return self._status

    def quality(self) -> dict[str, Any] | None:
        return self._quality.latest

    def ues(self) -> dict[str, Any]:
        return ue_list(self.chart())

    def chart_columns(self) -> dict[str, Any]:
        return chart_columns(self.chart(), self._plan.placed[0])

    def ask(self, operation: str, arguments: dict[str, Any]) -> dict[str, Any]:
        return self._pending.ask(operation, arguments)

    def set_method(self, theta: str, rho: str) -> dict[str, str]:
        return self.ask("set_method", checked_method(self._plan, theta, rho))

    def replay(
        self, *, paused: bool | None = None, speed: float | None = None, at_s: float | None = None
    ) -> dict[str, Any]:
        wishes = {"paused": paused, "speed": speed, "at_s": at_s}
        answer = self.ask("replay", wishes)
        if answer["jumped"]:
            self._collector.start_over()
        return answer

    def _run(self) -> None:
        show_name()
        try:
            self._serve()
        except Exception as error:
            log.exception("the node's loop failed")
            self._give_up(f"the node's loop failed: {error}")

    def _serve(self) -> None:
        next_status = 0.0
        while not self._finished.is_set():
            for kind, body, *rest in self._links.receive(LOOP_S):
                self._handle(kind, messages.unpack(body), rest)
            self._look_after_children()
            now = time.monotonic()
            if now >= next_status:
                next_status = now + STATUS_EVERY_S
                self._collector.tick(self._status)
                self._update_status()
                self._collector.report("status", self._status)
                self._notifier.alive(words(self._status))

    def _handle(self, kind: bytes, values: dict[str, Any], rest: list[bytes]) -> None:
        self._feeder.heard()
        if kind == messages.UPDATE:
            self._collector.take(messages.unpack_update(rest[0]), values["arrivals"])
        elif kind == messages.STATUS:
            self._take_status(values)
        elif kind == messages.REPLY:
            self._update_status()
            self._pending.answer(values)
        elif kind == messages.HELLO:
            self._workers.children[values["shard"]].is_up(values["pid"])
        elif kind == messages.HUNG:
            self._workers.children[values["shard"]].kill_hung(values["pid"])
        elif kind == messages.READY:
            self._feeder_ready(values["lossless"])
        elif kind == messages.SOURCE_READY:
            self._sources.is_ready(values["source"])
            self._all_ready()
        elif kind == messages.STARTED:
            self._feeder.reads()
            self._started_at = self._started_at or time.monotonic()
            self._state = "running" if self._give_up_at is None else self._state
            log.info("frames are read")
            self._notifier.ready()
        elif kind == messages.SETUP_ERROR:
            self._setup_failed(values["message"])
        elif kind == messages.DRAINED:
            self._take_status(values)
            self.failure = self.failure or values["failure"]
            self._end()

    def _take_status(self, values: dict[str, Any]) -> None:
        if (method := values["method"]) != self._method:
            self._method = method
            log.info("theta by %s, rho by %s from now on", method["theta"], method["rho"])
        self._feeder.heard(values)
        self._sources.look(values)

    def _feeder_ready(self, lossless: bool) -> None:
        self._collector.clock.live = not lossless
        self._feeder.ready = True
        self._feeder.supervised.is_up()
        if self._ready.is_set():  # it is not the first one: nobody else says go
            self._links.command(messages.GO, {})
            if self._give_up_at is not None:
                within_s = max(self._give_up_at - CLOSE_WITHIN_S - time.monotonic(), 0.0)
                self._links.command(messages.STOP, {"within_s": within_s})
        self._all_ready()

    def _all_ready(self) -> None:
        if self._feeder.ready and self._sources.ready:
            self._ready.set()

    def _setup_failed(self, message: str) -> None:
        """The source or a CSI sink cannot be opened: the end at the start, tried again later."""
        if self._ready.is_set():
            log.error("%s", message)
        else:
            self._setup_error = message
            self._give_up(message)

    def _start_feeder(self, counted: dict[str, Any] | None) -> Child:
        return self._launch.feeder(self._method, counted, self._sources.done)

    def _feeder_died(self) -> None:
        """Take what it had still sent. One that fails before it is ready would again; while the node drains,
        only one that reads again what a worker needs has a successor."""
        for kind, body, *rest in self._links.receive(0):
            self._handle(kind, messages.unpack(body), rest)
        code = self._feeder.supervised.last_code
        drains, failed = self._give_up_at is not None, not self._ready.is_set() and code > 0
        if failed or (drains and code != START_OVER):
            self._give_up("the feeder process died")

    def _resume(self) -> None:
        """Take up the counts and methods of the run that this one goes on with."""
        if (facts := self._kept.resumed) is not None:
            self._method = facts["method"]
            self._earlier_s = facts["seconds"]
            self._collector.table.evicted, self._collector.table.forgotten = facts["ues_gone"]
            if facts["feeder"]:
                self._feeder.resume(facts["feeder"])

    def _facts(self) -> dict[str, Any]:
        """What `_resume` needs."""
        table = self._collector.table
        return {
            "method": self._method,
            "seconds": self._run_time(),
            "ues_gone": [table.evicted, table.forgotten],
            "feeder": self._feeder.status,
        }

    def _look_after_children(self) -> None:
        if self._finished.is_set():
            return
        reason = self._children.check() or self._feeder.check() or self._quality.failure
        if self._finished.is_set():
            return
        if reason is not None:
            self._give_up(reason)
        elif self._give_up_at is not None and time.monotonic() >= self._give_up_at:
            self._give_up("the feeder process did not drain in time")

    def _give_up(self, reason: str) -> None:
        """End without a drain; what is not accounted for is counted as dropped."""
        self.failure = reason
        self._setup_error = self._setup_error or reason
        self._feeder.abandon()
        self._children.kill()
        self._end()

    def _end(self) -> None:
        self._seconds = self._run_time()
        self._finished.set()
        self._ready.set()

    def _run_time(self) -> float:
        if self._started_at is None:
            return self._earlier_s
        return self._seconds or self._earlier_s + time.monotonic() - self._started_at

    def _update_status(self) -> None:
        self._status = self._reporter.report(self._state, self._method, self._run_time(), self._kept.error)

    def _close_parts(self) -> None:
        for sink in self._collector.sinks:
            sink.close(CLOSE_WITHIN_S)
        if self._feeder.supervised.child is not None:
            self._feeder.supervised.child.close(CLOSE_WITHIN_S)
        self._kept.close()
        self._children.close(WORKERS_CLOSE_WITHIN_S)
        self._launch.close()
        if self._thread.ident is not None:
            self._thread.join()
        self._links.close()
        self.closed = True

    def _worker_died(self, shard: int, pid: int) -> None:
        self._links.command(messages.LOST, {"shard": shard, "pid": pid})
