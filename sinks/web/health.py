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
        self._called = self._reported = time.monotonic()
        self._status: dict[str, Any] = {"state": "starting"}
        self._frames = 0
        self._frames_at: float | None = None

    def called(self) -> None:
        """The node has called its sink."""
        self._called = time.monotonic()

    def status(self, report: dict[str, Any]) -> None:
        """The node has told how it is."""
        self._status, self._reported = report, time.monotonic()
        if report["frames_estimated"] != self._frames:
            self._frames = report["frames_estimated"]
            self._frames_at = time.monotonic()

    def trouble(self) -> str | None:
        """Why the node is not alive, or None: its loop, feeder or a worker has not stirred for too long."""
        silent = time.monotonic() - min(self._called, self._reported)
        if silent > STUCK_AFTER_S and self._status["state"] != "stopped":
            return f"the node has not stirred for {silent:.0f} s"
        stuck: str | None = self._status.get("stuck")
        return stuck

    def unready(self) -> str | None:
        """Why the node is not of use now, and what would help, or None."""
        if trouble := self.trouble():
            return trouble
        state = self._status["state"]
        if state != "running":
            why = "; ".join(text for key in ("reason", "fix") if (text := self._status.get(key)))
            return f"{state}: {why}" if why else str(state)
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
