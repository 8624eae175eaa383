"""Whether the node lives, and whether it is of use right now."""

from __future__ import annotations

import time
from typing import Any

from chachart.sinks.web.answers import Answer, Query, Route

STUCK_AFTER_S = 15.0


class Health:
    """Watches a node from one of its sinks.

    Parameters
    ----------
    stale_after_s
        Without a new frame for so long, the node is not ready.
    """

    def __init__(self, stale_after_s: float) -> None:
        self._stale_after_s = stale_after_s
        self._called = time.monotonic()
        self._state = "starting"
        self._frames = 0
        self._frames_at: float | None = None

    def called(self) -> None:
        """The node has called its sink."""
        self._called = time.monotonic()

    def status(self, report: dict[str, Any]) -> None:
        """The node has told its state."""
        self._state = report["state"]
        if report["frames_estimated"] != self._frames:
            self._frames = report["frames_estimated"]
            self._frames_at = time.monotonic()

    def trouble(self) -> str | None:
        """Why the node is not alive, or None."""
        silent = time.monotonic() - self._called
        return f"the node has not stirred for {silent:.0f} s" if silent > STUCK_AFTER_S else None

    def unready(self) -> str | None:
        """Why the node is not of use now, or None."""
        if trouble := self.trouble():
            return trouble
        if self._state != "running":
            return self._state
        if self._frames_at is None:
            return "no frame has come yet"
        stale = time.monotonic() - self._frames_at
        return f"no frame for {stale:.0f} s" if stale > self._stale_after_s else None


def health_routes(health: Health) -> dict[str, Route]:
    """`/healthz` and `/readyz`, for any web server of a node."""

    def healthz(_: Query) -> Answer:
        trouble = health.trouble()
        return Answer.text(503 if trouble else 200, trouble or "alive")

    def readyz(_: Query) -> Answer:
        unready = health.unready()
        return Answer.text(503 if unready else 200, unready or "ready")

    return {"GET /healthz": healthz, "GET /readyz": readyz}
