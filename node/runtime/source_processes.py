"""The processes of several sources as the main process sees them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import Any

from chachart.node.runtime.child import Child
from chachart.node.runtime.plan import Plan
from chachart.node.runtime.supervisor import SupervisedChild

log = logging.getLogger(__name__)

MOST_DEATHS = 3
SILENT_S = 30.0
"""A process that lives and says nothing for so long hangs."""


class SourceProcesses:
    """One process a source where there are several, none where there is one: the feeder process reads it.

    What becomes of one is its own matter: it is started again for as long as the node runs. Only a recording
    that fails again and again ends the node, since it will not get better.

    Parameters
    ----------
    plan
        What the node does.
    start
        Starts the process of the source of that number.

    Attributes
    ----------
    children
        The processes.
    """

    def __init__(self, plan: Plan, start: Callable[[int], Child]) -> None:
        self._feeds = plan.feeds if plan.further else ()
        self.children = [
            SupervisedChild(
                f"the source of {feed.name}",
                partial(start, number),
                partial(self._died, number),
                MOST_DEATHS if feed.source.lossless else None,
                tenacious=not feed.source.lossless,
            )
            for number, feed in enumerate(self._feeds)
        ]
        self._ready = [False for _ in self._feeds]

    @property
    def ready(self) -> bool:
        """Whether all are open."""
        return all(self._ready)

    @property
    def done(self) -> tuple[bool, ...]:
        """Which have ended because they had given everything."""
        return tuple(child.is_done for child in self.children)

    def is_ready(self, number: int) -> None:
        """One of them is open."""
        self._ready[number] = True
        self.children[number].is_up()

    def look(self, fed: dict[str, Any]) -> None:
        """End those that hang, by what the feeder process says of them."""
        for child, ready, report in zip(self.children, self._ready, _told(fed), strict=False):
            if ready and not report["ended"] and report["silent_s"] > SILENT_S and child.child is not None:
                log.error("%s hangs: not heard of for %.0f s", child.name, report["silent_s"])
                child.kill()

    def reports(self, fed: dict[str, Any]) -> list[dict[str, Any]]:
        """One map a source, see `NodeStatus.sources`."""
        told = _told(fed) or [{} for _ in self.children]
        return [
            {
                "name": feed.name,
                "type": feed.settings.type,
                "pid": child.child.pid if ready and child.child is not None else None,
                "restarts": child.restarts,
                "live": not feed.source.lossless,
                "frames": report.get("frames", 0),
                "quiet_s": report.get("quiet_s", 0.0),
                "ended": report.get("ended", False),
                "details": report.get("details", {}),
            }
            for feed, child, ready, report in zip(self._feeds, self.children, self._ready, told, strict=True)
        ]

    def _died(self, number: int, pid: int) -> None:
        self._ready[number] = False


def _told(fed: dict[str, Any]) -> list[dict[str, Any]]:
    told: list[dict[str, Any]] = fed.get("source", {}).get("sources", [])
    return told
