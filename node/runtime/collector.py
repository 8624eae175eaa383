"""Where chart updates arrive in the main process: the table, the latency, and the sinks."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from chachart.node.data.alerts import AlertSettings
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.zones import ZoneSettings
from chachart.node.estimation.options import Options
from chachart.node.runtime.alert_watch import AlertWatch
from chachart.node.runtime.latency import Latency
from chachart.node.runtime.plan import Plan
from chachart.node.runtime.processor import FrameClock
from chachart.node.runtime.sink_thread import SinkThread
from chachart.node.runtime.table import ChartTable
from chachart.sinks.base import NodeAccess

LATENCY_WINDOW_S = 5.0
SINK_QUEUE = 512


class Collector:
    """Takes updates from the workers and hands them on. One thread calls `take` and `tick`.

    Attributes
    ----------
    table
        The chart as it stands.
    sinks
        Everybody who wants updates.
    has_truth
        Whether a known position has been seen.
    latency
        Over the whole run.
    alerts
        Looks at the chart now and then.
    """

    def __init__(
        self, estimator: Options, alerts: Sequence[AlertSettings] = (), zones: Sequence[ZoneSettings] = ()
    ) -> None:
        self.alerts = AlertWatch(alerts, zones)
        self.table = ChartTable(estimator.max_ues)
        self.sinks: list[SinkThread] = []
        self.latency = Latency()
        self.clock = FrameClock(live=False)
        self.has_truth = False
        self._forget_after_ns = int((estimator.forget_after_s or 0) * 1e9)
        self._window = Latency()
        self._window_ends = 0.0
        self._recent_ms = self._window.percentiles_ms()

    def open_sinks(self, plan: Plan, node: NodeAccess) -> None:
        """Open all sinks that take charts.

        Raises
        ------
        SetupError
            If one of them cannot be opened.
        """
        first, *others = plan.placed
        for sink_class, settings in plan.sinks:
            if not sink_class.wants_csi:
                made = sink_class(settings, first)
                made.security, made.others = plan.security, tuple(others)
                sink = SinkThread(made, settings.type, SINK_QUEUE)
                sink.open(node)
                self.sinks.append(sink)

    def addresses(self) -> list[tuple[str, str]]:
        """Where a person finds what the sinks give, by sink."""
        places = ((sink.name, sink.where()) for sink in self.sinks)
        return [(name, where) for name, where in places if where]

    def take(self, update: ChartUpdate, arrivals: Iterable[tuple[float, int]]) -> None:
        """An update, and when the frames behind it came in: (monotonic seconds, frames)."""
        self.table.update(update)
        truth = update.columns.get("position")
        self.has_truth = self.has_truth or (truth is not None and bool(np.isfinite(truth).any()))
        self.clock.see(int(update.time_ns.max()))
        for sink in self.sinks:
            sink.put(update)
        now = time.monotonic()
        for arrival, frames in arrivals:
            self.latency.add(now - arrival, frames)
            self._window.add(now - arrival, frames)

    def start_over(self) -> None:
        """The source has jumped in time: what the chart held is of another time."""
        self.table.clear()
        self.alerts.start_over()
        self.clock.start_over()

    def tick(self, status: Mapping[str, Any]) -> None:
        """Forget UEs unseen for too long, and raise alerts; `status` is the latest report."""
        now_ns = self.clock.now_ns()
        if self.alerts.alerts:
            clocks = time.monotonic(), time.time_ns()
            for event in self.alerts.judge(self.table.chart(), now_ns, status, *clocks):
                for sink in self.sinks:
                    sink.alert(event)
        if self._forget_after_ns and now_ns is not None:
            self.table.forget(now_ns - self._forget_after_ns)

    def report(self, kind: str, values: dict[str, Any]) -> None:
        """Hand a `quality` or `status` report to all sinks."""
        for sink in self.sinks:
            sink.report(kind, values)

    def recent_latency_ms(self) -> dict[str, float | None]:
        """Percentiles over the last seconds."""
        now = time.monotonic()
        if now >= self._window_ends:
            self._recent_ms = self._window.percentiles_ms()
            self._window, self._window_ends = Latency(), now + LATENCY_WINDOW_S
        if self._recent_ms["p50"] is None:
            return self._window.percentiles_ms()
        return self._recent_ms
