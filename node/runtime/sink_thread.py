"""A thread and a bounded queue for each sink, so that none holds up the estimates or another sink."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.runtime.thread_names import show_name
from chachart.sinks.base import NodeAccess, Sink

log = logging.getLogger(__name__)

TICK_S = 0.05
COMPLAIN_EVERY_S = 10.0
ASK_EVERY_S = 0.2


class SinkThread:
    """Runs one sink.

    What waits is handed over at once: all chart updates as one call with the newest row of each UE, of
    quality and status reports only the latest. A sink that raises is complained about and goes on.

    Parameters
    ----------
    sink, name
        The sink, and what the log and the status call it.
    capacity
        Updates or blocks that may wait.
    lossless
        Whether a full queue makes `put` wait; else the oldest is dropped and counted.
    """

    def __init__(self, sink: Sink, name: str, capacity: int, lossless: bool = False) -> None:
        self.sink = sink
        self.name = name
        self.received = 0
        self.errors = 0
        self.dropped = Counters()
        self._handed_over = 0
        self._capacity = capacity
        self._lossless = lossless
        self._queue: deque[ChartUpdate | CsiBlock] = deque()
        self._reports: dict[str, dict[str, Any]] = {}
        self._alerts: deque[dict[str, Any]] = deque()
        self._condition = threading.Condition()
        self._closing = False
        self._complained = -COMPLAIN_EVERY_S
        self._next_tick = 0.0
        self._opened = threading.Event()
        self._failure: SetupError | None = None
        self._thread = threading.Thread(target=self._run, name=f"sink {name}", daemon=True)

    def open(self, node: NodeAccess | None) -> None:
        """Start the thread and open the sink in it.

        Raises
        ------
        SetupError
            If the sink cannot be opened.
        """
        self._node = node
        self._thread.start()
        self._opened.wait()
        if self._failure is not None:
            raise self._failure

    def put(self, item: ChartUpdate | CsiBlock) -> None:
        """Hand over a chart update or a CSI block."""
        with self._condition:
            self.received += len(item)
            while self._lossless and len(self._queue) >= self._capacity and not self._closing:
                self._condition.wait()
            if len(self._queue) >= self._capacity:
                self.dropped.add("queue_full", len(self._queue.popleft()))
            self._queue.append(item)
            self._condition.notify_all()

    def report(self, kind: str, values: dict[str, Any]) -> None:
        """Hand over a `quality` or `status` report."""
        with self._condition:
            self._reports[kind] = values
            self._condition.notify_all()

    def alert(self, event: dict[str, Any]) -> None:
        """Hand over an alert; none is left out, but where the sink has taken none for long."""
        with self._condition:
            if len(self._alerts) >= self._capacity:
                self._alerts.popleft()
                self.dropped.add("alerts", 1)
            self._alerts.append(event)
            self._condition.notify_all()

    def close(self, timeout: float, patient: Callable[[], bool] = lambda: False) -> None:
        """Let the sink take what waits, then close it; gives up after `timeout` seconds.

        Meanwhile `patient` is asked again and again: if it says so, a sink that gets on has as long again.
        """
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        taken, deadline = self._handed_over, time.monotonic() + timeout
        while self._thread.is_alive() and (now := time.monotonic()) < deadline:
            if patient() and self._handed_over > taken:
                taken, deadline = self._handed_over, now + timeout
            self._thread.join(min(ASK_EVERY_S, deadline - now))
        if self._thread.is_alive():
            with self._condition:
                left = self.received - self._handed_over - self.dropped.as_dict().get("queue_full", 0)
                self.dropped.add("not_finished", left)
            log.error("sink %s did not finish within %.0f s; %d did not get there", self.name, timeout, left)

    def where(self) -> str | None:
        """Where a person finds what the sink gives, as far as the sink can tell."""
        try:
            where = self.sink.where()
        except Exception:
            if self._failed(0):
                log.exception("sink %s cannot tell where it is", self.name)
            return None
        return None if where is None else str(where)

    def status(self) -> dict[str, Any]:
        """Counts for the node's status report."""
        return {
            "name": self.name,
            "where": self.where(),
            "received": self.received,
            "dropped": self.dropped.as_dict() | self.sink.lost.as_dict(),
            "refused": self.sink.refused.as_dict(),
            "errors": self.errors,
            "trouble": self.sink.trouble,
        }

    def _run(self) -> None:
        show_name()
        try:
            self.sink.open(self._node)
        except SetupError as error:
            self._failure = error
            return
        except Exception as error:
            log.exception("sink %s cannot be opened", self.name)
            self._failure = SetupError(f"sink {self.name} cannot be opened: {error}")
            return
        finally:
            self._opened.set()
        while self._round():
            pass
        self._call(self.sink.close)

    def _round(self) -> bool:
        """Hand over what waits, or tick; False when closing and nothing is left."""
        with self._condition:
            if not (self._queue or self._reports or self._alerts or self._closing):
                self._condition.wait(TICK_S)
            items, reports, alerts = list(self._queue), self._reports, list(self._alerts)
            self._queue.clear()
            self._alerts.clear()
            self._reports = {}
            self._condition.notify_all()
            if not (items or reports or alerts) and self._closing:
                return False
        updates = [item for item in items if isinstance(item, ChartUpdate)]
        blocks = [item for item in items if isinstance(item, CsiBlock)]
        if updates:
            merged = ChartUpdate.concatenate(updates)
            self._call(self.sink.on_chart, merged, frames=len(merged))
            self._handed_over += sum(map(len, updates))
        for block in blocks:
            self._call(self.sink.on_csi, block, frames=len(block))
            self._handed_over += len(block)
        for event in alerts:
            self._call(self.sink.on_alert, event)
        for kind, values in reports.items():
            self._call(self.sink.on_quality if kind == "quality" else self.sink.on_status, values)
        if time.monotonic() >= self._next_tick:
            self._next_tick = time.monotonic() + TICK_S
            self._call(self.sink.on_tick)
        return True

    def _call(self, method: Any, *arguments: Any, frames: int = 0) -> None:
        try:
            method(*arguments)
        except OSError as error:  # a full disk, for instance: one line says all
            if self._failed(frames):
                log.error("sink %s: %s failed: %s", self.name, method.__name__, error)
        except Exception as error:
            if self._failed(frames):
                log.exception("sink %s: %s failed: %s", self.name, method.__name__, error)

    def _failed(self, frames: int) -> bool:
        """Count a failure; whether it is time to complain about it."""
        self.errors += 1
        if frames:
            self.dropped.add("sink_failed", frames)
        if time.monotonic() < self._complained + COMPLAIN_EVERY_S:
            return False
        self._complained = time.monotonic()
        return True
