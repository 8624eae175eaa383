"""Prometheus metrics of a node.

All numbers come from the node's latest status report at the moment of the scrape: nothing is counted twice
and the estimates never wait for monitoring. No metric has a UE as a label.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4, CollectorRegistry, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from chachart.sinks.base import NodeAccess
from chachart.sinks.web.answers import Answer, Query, Route

STATES = ("starting", "running", "degraded", "draining", "stopped")
_COUNTS = {
    "frames_in": "Frames that came in.",
    "frames_estimated": "Frames behind an estimate.",
    "gaps": "Frames missing by the source's own numbering.",
    "out_of_order": "Frames late by the source's own numbering.",
    "ues_evicted": "UEs that made room for others.",
    "ues_forgotten": "UEs unseen for too long.",
    "restamped": "Live frames whose time was too far from this host's.",
    "state_lost": "Frames that are in their UEs' estimates no more.",
    "ues_reset": "UEs that started afresh because their state was lost.",
    "feeder_restarts": "Times the feeder process had to be started again.",
}
_PER_WORKER = {
    "backlog_frames": "Frames waiting for a worker or unacknowledged by it.",
    "backlog_blocks": "Blocks waiting for a worker or unacknowledged by it.",
    "ues": "UEs in a worker's care.",
}
_QUALITY = {
    "tw": ("chachart_trustworthiness", "TW of the latest quality report."),
    "ct": ("chachart_continuity", "CT of the latest quality report."),
    "stress": ("chachart_stress", "Kruskal stress of the latest quality report."),
}


def exposition(status: Mapping[str, Any]) -> bytes:
    """A status report in Prometheus' text format."""
    registry = CollectorRegistry()
    registry.register(_Collector(status))
    return bytes(generate_latest(registry))


class _Collector(Collector):
    def __init__(self, status: Mapping[str, Any]) -> None:
        self._status = status

    def collect(self) -> Iterator[Metric]:
        status = self._status
        if not status:
            return
        method = {key: status["method"].get(key, "") for key in ("theta", "rho")}
        labels = {"array": status["array"], "source": status["source"], **method}
        yield InfoMetricFamily("chachart_node", "What the node does.", value=labels)
        state = GaugeMetricFamily("chachart_state", "1 for the state that the node is in.", labels=["state"])
        for name in STATES:
            state.add_metric([name], float(status["state"] == name))
        yield state
        for key, text in _COUNTS.items():
            yield CounterMetricFamily(f"chachart_{key}", text, value=status[key])
        for key, text in (("dropped", "Frames lost on the way"), ("rejected", "Input that was no frame")):
            yield _by_label(f"chachart_{key}", f"{text}, by reason.", "reason", status[key])
        yield GaugeMetricFamily("chachart_ues", "UEs on the chart.", value=status["ues"])
        yield _latency(status["latency_histogram"])
        yield from self._sources()
        yield from self._arrays()
        yield from self._workers()
        yield from self._sinks()
        yield from self._quality()
        yield from self._antennas()
        yield from self._alerts()

    def _alerts(self) -> Iterator[Metric]:
        active = GaugeMetricFamily(
            "chachart_alert_active", "UEs or antennas of which an alert holds, or 1.", labels=["alert"]
        )
        raised = CounterMetricFamily(
            "chachart_alerts_raised", "How often an alert was raised.", labels=["alert"]
        )
        for name, count in self._status["alerts"].get("counts", {}).items():
            active.add_metric([name], count)
            raised.add_metric([name], self._status["alerts"]["raised"][name])
        yield from (active, raised)

    def _sources(self) -> Iterator[Metric]:
        """Of several sources each."""
        frames = CounterMetricFamily("chachart_source_frames", "Frames of a source.", labels=["arrays"])
        restarts = CounterMetricFamily(
            "chachart_source_restarts", "Times a source had to be started again.", labels=["arrays"]
        )
        quiet = GaugeMetricFamily(
            "chachart_source_quiet_seconds", "Since the last frame of a source.", labels=["arrays"]
        )
        for source in self._status["sources"]:
            frames.add_metric([source["name"]], source["frames"])
            restarts.add_metric([source["name"]], source["restarts"])
            quiet.add_metric([source["name"]], source["quiet_s"])
        yield from (frames, restarts, quiet)

    def _arrays(self) -> Iterator[Metric]:
        """Of several arrays each."""
        share = GaugeMetricFamily(
            "chachart_array_share", "Part of the transmissions that an array hears.", labels=["array"]
        )
        offset = GaugeMetricFamily(
            "chachart_array_offset_seconds", "By how much an array's clock is late.", labels=["array"]
        )
        for array in self._status["arrays"]:
            share.add_metric([array["name"]], array["share"])
            if array["offset_ns"] is not None:
                offset.add_metric([array["name"]], array["offset_ns"] * 1e-9)
        yield from (share, offset)

    def _workers(self) -> Iterator[Metric]:
        workers = self._status["workers"]
        yield _by_label(
            "chachart_worker_restarts",
            "Times a worker had to be started again.",
            "worker",
            {str(worker["shard"]): worker["restarts"] for worker in workers},
        )
        for key, text in _PER_WORKER.items():
            family = GaugeMetricFamily(f"chachart_worker_{key}", text, labels=["worker"])
            for worker in workers:
                family.add_metric([str(worker["shard"])], worker.get(key, 0))
            yield family

    def _sinks(self) -> Iterator[Metric]:
        received = CounterMetricFamily("chachart_sink_rows", "Rows or frames a sink took.", labels=["sink"])
        dropped = CounterMetricFamily("chachart_sink_dropped", "Rows or frames a sink lost.", labels=["sink"])
        recorded = GaugeMetricFamily("chachart_recorder_bytes", "Size of a recording.", labels=["sink"])
        for number, sink in enumerate(self._status["sinks"]):
            label = [f"{number}:{sink['name']}"]
            received.add_metric(label, sink["received"])
            dropped.add_metric(label, sum(sink["dropped"].values()))
            if sink["name"] == "recorder" and sink["where"] and (path := Path(sink["where"])).is_file():
                recorded.add_metric(label, path.stat().st_size)
        yield from (received, dropped, recorded)

    def _quality(self) -> Iterator[Metric]:
        report = self._status["quality"] or {}
        for key, (name, text) in _QUALITY.items():
            if report.get(key) is not None:
                yield GaugeMetricFamily(name, text, value=report[key])

    def _antennas(self) -> Iterator[Metric]:
        report = self._status.get("antennas") or {}
        for key, text in (("power_db", "Power"), ("coherent_db", "Coherent part of the power")):
            family = GaugeMetricFamily(
                f"chachart_antenna_{key}", f"{text} of an antenna against the median, dB.", labels=["antenna"]
            )
            for number, value in enumerate(report.get(key, [])):
                family.add_metric([str(number)], value)
            yield family
        faults = GaugeMetricFamily(
            "chachart_antenna_fault", "Antennas that look broken.", labels=["antenna", "fault"]
        )
        for number, fault in report.get("faults", {}).items():
            faults.add_metric([number, fault], 1)
        yield faults
        dead = GaugeMetricFamily(
            "chachart_antenna_dead_seconds", "Since when an antenna has given nothing.", labels=["antenna"]
        )
        for number, seconds in report.get("dead_s", {}).items():
            dead.add_metric([number], seconds)
        yield dead


def _by_label(name: str, text: str, label: str, counts: Mapping[str, int]) -> Metric:
    family = CounterMetricFamily(name, text, labels=[label])
    for value, count in sorted(counts.items()):
        family.add_metric([value], count)
    return family


def _latency(histogram: Mapping[str, Any]) -> Metric:
    name = "chachart_latency_seconds"
    family = HistogramMetricFamily(name, "From a frame's arrival to its estimate's hand-over to the sinks.")
    if histogram:
        buckets = [(str(le), n) for le, n in zip(histogram["le_s"], histogram["frames"], strict=True)]
        family.add_metric([], [*buckets, ("+Inf", histogram["total"])], histogram["sum_s"])
    return family


def metrics_routes(node: NodeAccess) -> dict[str, Route]:
    """`/metrics`, for any web server of a node."""

    def metrics(_: Query) -> Answer:
        return Answer(exposition(node.status()), CONTENT_TYPE_PLAIN_0_0_4)

    return {"GET /metrics": metrics}
