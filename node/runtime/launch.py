"""Starting a node's child processes: what each is told."""

from __future__ import annotations

from typing import Any

from chachart.node.data.facts import CaptureFacts
from chachart.node.files.folders import Folder
from chachart.node.runtime.child import Child, ChildProcess, class_path
from chachart.node.runtime.gathered import GatheredSources
from chachart.node.runtime.links import Links
from chachart.node.runtime.plan import Feed, Plan
from chachart.node.runtime.worker_pool import make_pool


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

    Raises
    ------
    SetupError
        If workers cannot be where they should.
    """

    def __init__(self, plan: Plan, links: Links, log_level: int, folder: Folder | None) -> None:
        self._plan = plan
        self._links = links
        self._pool = make_pool(plan.workers, plan.array.name, links)
        self._lives = 0
        self._endpoints = {**links.endpoints, "workers": self._pool.endpoint}
        self._common: dict[str, Any] = {
            "log_level": log_level,
            "directory": str(links.directory),
            "array": plan.array.as_dict(),
            "others": [other.as_dict() for other in plan.others],
        }
        facts = CaptureFacts.together(feed.source.carried_facts(feed.settings) for feed in plan.feeds)
        self._facts = facts.as_dict()
        self.tally = links.directory / "frames-in"
        durable = plan.state.directory is not None
        self._state = {"folder": None if folder is None else str(folder), "durable": durable}

    def source(self, number: int) -> Child:
        """Start the process of one of several sources."""
        feed = self._plan.feeds[number]
        self._lives += 1
        settings = {
            "log_level": self._common["log_level"],
            "directory": self._common["directory"],
            "number": number,
            "source": _source(feed),
            "arrays": [array.as_dict() for array in feed.arrays],
            "security": self._security(),
            "results": self._endpoints["results"],
            "endpoint": self._links.of_source(number),
            "identity": f"{number}.{self._lives}",
        }
        return Child(f"source of {feed.name}", "chachart.node.runtime.source_process", settings)

    def feeder(
        self, method: dict[str, str], counted: dict[str, Any] | None, ended: tuple[bool, ...] = ()
    ) -> Child:
        """Start the process with the source and the CSI sinks.

        Parameters
        ----------
        method
            {theta, rho} to estimate with.
        counted
            The last status of the one before; None if there was none.
        ended
            Which of several sources have given all they had.
        """
        plan = self._plan
        settings = {
            **self._common,
            "sockets": self._endpoints,
            "keys": None if self._pool.keys is None else str(self._pool.keys),
            "security": self._security(),
            "source": self._gathered(ended) if plan.further else _source(plan.feeds[0]),
            "workers": {**plan.workers.model_dump(mode="json"), "block_frames": plan.block_frames},
            "estimator": method,
            "state": plan.state.model_dump(mode="json"),
            "counted": counted,
            "time_tolerance_s": plan.time_tolerance_s,
            "tally": str(self.tally),
            "facts": self._facts,
            "csi_sinks": [
                {"class": class_path(sink), "settings": settings.model_dump(mode="json")}
                for sink, settings in plan.sinks
                if sink.wants_csi
            ],
        }
        return Child("feeder", "chachart.node.runtime.feeder", settings)

    def worker(self, shard: int) -> ChildProcess:
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
        return self._pool.start(shard, settings)

    def close(self) -> None:
        """When all children have ended: let go of where the workers ran."""
        self._pool.close()

    def _security(self) -> dict[str, Any]:
        told: dict[str, Any] = self._plan.security.model_dump(mode="json", exclude={"token", "read_token"})
        return told

    def _gathered(self, ended: tuple[bool, ...]) -> dict[str, Any]:
        """The source that several are for the feeder process."""
        feeds = self._plan.feeds
        opened = [feed.source(feed.settings, feed.arrays[0]) for feed in feeds]
        settings = {
            "type": "several",
            "endpoints": [self._links.of_source(number) for number in range(len(feeds))],
            "names": [feed.name for feed in feeds],
            "lossless": all(source.lossless for source in opened),
            "in_step": all(feed.source.lossless for feed in feeds),
            "ended": ended,
            "tally": self._common["directory"] + "/taken",
        }
        return {"class": class_path(GatheredSources), "settings": settings}

    def quality(self) -> Child:
        """Start the process that assesses charts."""
        settings = {**self._common, "quality": self._endpoints["quality"]}
        child = Child("quality", "chachart.node.runtime.quality_watch", settings)
        child.yield_to_others()
        return child


def _source(feed: Feed) -> dict[str, Any]:
    return {"class": class_path(feed.source), "settings": feed.settings.model_dump(mode="json")}
