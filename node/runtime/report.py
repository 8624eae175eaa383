"""Puts the node's report about itself together from what its parts say."""

from __future__ import annotations

import time
from typing import Any

from chachart.node.runtime.collector import Collector
from chachart.node.runtime.condition import ConditionWatch
from chachart.node.runtime.feeder_process import FeederProcess
from chachart.node.runtime.plan import Plan
from chachart.node.runtime.quality_watch import QualityWatch
from chachart.node.runtime.source_processes import SourceProcesses
from chachart.node.runtime.status import NodeStatus, Rates
from chachart.node.runtime.supervisor import Supervisor


class Reporter:
    """Makes status reports.

    Parameters
    ----------
    plan, collector, feeder, workers, sources, quality
        The parts.
    """

    def __init__(
        self,
        plan: Plan,
        collector: Collector,
        feeder: FeederProcess,
        workers: Supervisor,
        sources: SourceProcesses,
        quality: QualityWatch,
    ) -> None:
        self._plan = plan
        self._collector = collector
        self._feeder = feeder
        self._workers = workers
        self._sources = sources
        self._quality = quality
        self._rates = Rates()
        self._condition = ConditionWatch()

    def report(
        self, state: str, method: dict[str, str], seconds: float, state_error: str | None
    ) -> dict[str, Any]:
        """A `NodeStatus` as plain values."""
        fed, table = self._feeder.status, self._collector.table
        frames_in, estimated = fed.get("frames_in", 0), fed.get("frames_estimated", 0)
        rates = self._rates.add(time.monotonic(), frames_in, estimated)
        workers = self._worker_reports()
        for_arrays = [worker.pop("arrays", []) for worker in workers]
        status = NodeStatus(
            state=state,
            array=self._plan.array.name,
            source=self._plan.source_settings.type,
            sources=self._sources.reports(fed),
            arrays=_arrays(for_arrays),
            method=method,
            lossless=not self._collector.clock.live,
            seconds=seconds,
            blocks_in=fed.get("blocks_in", 0),
            frames_in=frames_in,
            frames_estimated=estimated,
            backlog_frames=sum(worker.get("backlog_frames", 0) for worker in workers),
            frames_in_per_s=rates[0],
            frames_estimated_per_s=rates[1],
            dropped=fed.get("dropped", {}),
            rejected=fed.get("rejected", {}),
            gaps=fed.get("gaps", 0),
            out_of_order=fed.get("out_of_order", 0),
            restamped=fed.get("restamped", 0),
            ues=len(table),
            ues_evicted=table.evicted,
            ues_forgotten=table.forgotten,
            latency_ms=self._collector.recent_latency_ms(),
            latency_histogram=self._collector.latency.histogram(),
            quality=self._quality.latest,
            workers=workers,
            sinks=[sink.status() for sink in self._collector.sinks] + fed.get("csi_sinks", []),
            recording=fed.get("recording"),
            antennas=fed.get("antennas", {}),
            source_details=fed.get("source", {}),
            state_lost=self._feeder.total("state_lost"),
            ues_reset=self._feeder.total("ues_reset"),
            feeder_restarts=self._feeder.supervised.restarts,
            feeder_pid=self._feeder.pid,
            stuck=self._feeder.stuck or next((w["stuck"] for w in workers if w.get("stuck")), None),
            state_error=state_error,
            relative=self._relative(method),
            complaint=fed.get("complaint"),
            alerts=self._collector.alerts.report(),
        ).as_dict()
        condition = self._condition.judge(status, time.monotonic())
        return {**status, "state": condition.state, "reason": condition.reason, "fix": condition.fix}

    def _relative(self, method: dict[str, str]) -> bool:
        """Whether nothing gives distances a scale."""
        unscaled = self._plan.estimator.isq_reference is None and not self._collector.has_truth
        return method["rho"] == "isq" and unscaled and len(self._collector.table) > 0

    def _worker_reports(self) -> list[dict[str, Any]]:
        children = self._workers.children
        known = self._feeder.status.get("workers") or [{} for _ in children]
        return [
            {
                "shard": shard,
                "ues": 0,
                **worker,
                "restarts": child.restarts,
                "pid": child.pid,
                "lacks": child.lacks,
            }
            for shard, (child, worker) in enumerate(zip(children, known, strict=True))
        ]


def _arrays(reports: list[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """What all workers say of the arrays together: `NodeStatus.arrays`."""
    told = [report for report in reports if report]
    found = []
    for of_one in zip(*told, strict=True):
        transmissions = sum(one["transmissions"] for one in of_one)
        clocks = sorted((one for one in of_one if one["offset_ns"] is not None), key=_offset)
        middle = clocks[len(clocks) // 2] if clocks else {}
        found.append(
            {
                "name": of_one[0]["name"],
                "share": sum(one["heard"] for one in of_one) / transmissions if transmissions else 0.0,
                **{name: middle.get(name) for name in ("offset_ns", "offset_std_ns", "drift_ns")},
            }
        )
    return found


def _offset(array: dict[str, Any]) -> float:
    return float(array["offset_ns"])
