"""Everyone who looks at the chart, and what each of them still has to get.

Nothing waits without bound: of reports only the newest of each kind, of chart frames a few; a viewer who
falls further behind gets the whole chart once it listens again. Frames are encoded once for all.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections import deque
from typing import Any

from websockets.asyncio.server import ServerConnection

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.geometry import ArrayGeometry
from chachart.sinks.base import NodeAccess
from chachart.sinks.plain import encoded, plain
from chachart.sinks.view.frames import encode_frame
from chachart.sinks.view.history import History

FRAMES_WAITING = 4
UPDATES_WAITING = 64
WHOLE_EVERY_S = 1.0
"""Nobody gets the whole chart more often."""
REPORTS_KEPT = 720


class Viewer:
    """One viewer's outbox. `flowing` is False while it does not want charts."""

    def __init__(self) -> None:
        self.flowing = True
        self._whole = True
        self._whole_at = -math.inf
        self._frames: deque[bytes] = deque()
        self._texts: dict[str, str] = {}
        self._wake = asyncio.Event()
        self._wake.set()

    def frame(self, frame: bytes) -> None:
        """A chart frame for the viewer, unless it gets the whole chart anyway."""
        if self.flowing and not self._whole:
            self._frames.append(frame)
            if len(self._frames) > FRAMES_WAITING:
                self.start_over()
        self._wake.set()

    def text(self, key: str, text: str) -> None:
        """A message that replaces an unsent one with the same key."""
        self._texts[key] = text
        self._wake.set()

    def start_over(self) -> None:
        """Send the whole chart instead of what waits."""
        self._whole = True
        self._frames.clear()
        self._wake.set()

    def look_back(self, frame: bytes) -> None:
        """A chart of the past instead of what flows; `flow(True)` ends it."""
        self.flowing = self._whole = False
        self._frames.clear()
        self._frames.append(frame)
        self._wake.set()

    def until_next_whole(self) -> float:
        """How long to wait (s) before it gets anything as long as the chart again; that is counted as had."""
        now = time.monotonic()
        self._whole_at = max(now, self._whole_at + WHOLE_EVERY_S)
        return self._whole_at - now

    def flow(self, on: bool) -> None:
        """Let charts flow, or stop them."""
        if on and not self.flowing:
            self.start_over()
        self.flowing = on

    async def run(self, connection: ServerConnection, hub: Hub) -> None:
        """Send what waits, until cancelled.

        Raises
        ------
        ConnectionClosed
            When the viewer has gone.
        """
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._texts:
                await connection.send(self._texts.pop(next(iter(self._texts))))
            if self._whole and self.flowing:
                await asyncio.sleep(self.until_next_whole())
                self._whole = False
                whole = await hub.whole()
                if whole is None:
                    self._whole = True
                else:
                    await connection.send(whole)
            while self._frames and not self._whole:
                await connection.send(self._frames.popleft())


class Hub:
    """Merges what the node tells and passes it on at a steady pace. Without viewers it does next to nothing.

    Parameters
    ----------
    arrays, node
        The arrays and the node that the view belongs to.
    rate_hz
        Chart frames a second.
    history
        The chart of the last minutes.
    """

    def __init__(
        self, arrays: tuple[ArrayGeometry, ...], node: NodeAccess, rate_hz: float, history: History
    ) -> None:
        self.viewers: set[Viewer] = set()
        self.array, self.arrays = arrays[0], arrays
        self.rate_hz = rate_hz
        self.history = history
        self._node = node
        self._updates: list[ChartUpdate] = []
        self._lock = threading.Lock()
        self._tick = 0
        self._whole: tuple[int, asyncio.Task[bytes | None]] | None = None
        self._statuses: deque[dict[str, Any]] = deque(maxlen=REPORTS_KEPT)
        self._qualities: deque[dict[str, Any]] = deque(maxlen=REPORTS_KEPT)

    def offer(self, update: ChartUpdate) -> None:
        """The node's newest estimates; from any thread."""
        if not self.viewers:
            return
        with self._lock:
            self._updates.append(update)
            if len(self._updates) > UPDATES_WAITING:
                self._updates = [ChartUpdate.concatenate(self._updates)]

    def tell(self, kind: str, report: dict[str, Any]) -> None:
        """A status or quality report, in the server's thread."""
        kept = self._statuses if kind == "status" else self._qualities
        kept.append(report)
        if self.viewers:
            text = encoded({"type": kind, "history_s": self.history.seconds(), **report}).decode()
            for viewer in self.viewers:
                viewer.text(kind, text)

    def past(self) -> dict[str, list[dict[str, Any]]]:
        """Earlier reports for a viewer who has just come; of all but the latest only what curves need."""
        rates = [{key: s[key] for key in ("time_ns", "frames_estimated_per_s")} for s in self._statuses]
        qualities = [{key: v for key, v in q.items() if not isinstance(v, list)} for q in self._qualities]
        return {
            "statuses": rates[:-1] + list(self._statuses)[-1:],
            "qualities": qualities[:-1] + list(self._qualities)[-1:],
        }

    async def whole(self) -> bytes | None:
        """The whole chart as a frame, made at most once a tick; None before the first estimate."""
        if self._whole is None or self._whole[0] != self._tick:
            self._whole = (self._tick, asyncio.create_task(asyncio.to_thread(self._encode_whole)))
        return await asyncio.shield(self._whole[1])

    async def run(self) -> None:
        """Pass on what has come, `rate_hz` times a second."""
        while True:
            await asyncio.sleep(1 / self.rate_hz)
            self._tick += 1
            with self._lock:
                updates, self._updates = self._updates, []
            flowing = [viewer for viewer in self.viewers if viewer.flowing]
            if updates and flowing:
                frame = encode_frame(ChartUpdate.concatenate(updates), self.array, full=False)
                for viewer in flowing:
                    viewer.frame(frame)

    def _encode_whole(self) -> bytes | None:
        chart = self._node.chart()
        return None if chart is None else encode_frame(chart, self.array, full=True)


def report(values: dict[str, Any], time_ns: int) -> dict[str, Any]:
    """A report as the page gets it: plain values and a time."""
    return {"time_ns": time_ns, **plain(values)}
