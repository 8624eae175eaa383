"""Starting a node's child processes: what each is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from chachart.node.runtime.child import Child, class_path
from chachart.node.runtime.links import Links
from chachart.node.runtime.plan import Plan


class Launcher:
    """Starts the children of one node.

    Parameters
    ----------
    plan, links
        What the node does, and where its sockets are.
    log_level
        What the children log.
    folder
        Where snapshots go, None for nowhere.
    """

    def __init__(self, plan: Plan, links: Links, log_level: int, folder: Path | None) -> None:
        self._plan = plan
        self._endpoints = links.endpoints
        self._common: dict[str, Any] = {
            "log_level": log_level,
            "directory": str(links.directory),
            "array": plan.array.as_dict(),
            "others": [other.as_dict() for other in plan.others],
        }
        self.tally = links.directory / "frames-in"
        durable = plan.state.directory is not None
        self._state = {"folder": None if folder is None else str(folder), "durable": durable}

    def feeder(self, method: dict[str, str], counted: dict[str, Any] | None) -> Child:
        """Start the process with the source and the CSI sinks.

        Parameters
        ----------
        method
            {theta, rho} to estimate with.
        counted
            The last status of the one before; None if there was none.
        """
        plan = self._plan
        settings = {
            **self._common,
            "sockets": self._endpoints,
            "security": plan.security.model_dump(mode="json", exclude={"token", "read_token"}),
            "source": {
                "class": class_path(plan.source),
                "settings": plan.source_settings.model_dump(mode="json"),
            },
            "workers": {**plan.workers.model_dump(mode="json"), "block_frames": plan.block_frames},
            "estimator": method,
            "state": plan.state.model_dump(mode="json"),
            "counted": counted,
            "time_tolerance_s": plan.time_tolerance_s,
            "tally": str(self.tally),
            "csi_sinks": [
                {"class": class_path(sink), "settings": settings.model_dump(mode="json")}
                for sink, settings in plan.sinks
                if sink.wants_csi
            ],
        }
        return Child("feeder", "chachart.node.runtime.feeder", settings)

    def worker(self, shard: int) -> Child:
        """Start the process that estimates the UEs of `shard`."""
        settings = {
            **self._common,
            "workers": self._endpoints["workers"],
            "shard": shard,
            "count": self._plan.workers.count,
            "estimator": self._plan.worker_estimator(),
            "state": self._state,
            "several": self._plan.several(),
        }
        return Child(f"worker {shard}", "chachart.node.runtime.worker", settings)

    def quality(self) -> Child:
        """Start the process that assesses charts."""
        settings = {**self._common, "quality": self._endpoints["quality"]}
        child = Child("quality", "chachart.node.runtime.quality_watch", settings)
        child.yield_to_others()
        return child
