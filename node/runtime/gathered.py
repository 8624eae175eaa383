"""Several sources as the feeder process sees them: one source, whose blocks come from their processes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import zmq

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.wire import decode_csi
from chachart.node.runtime import messages
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.numbering import Numbering

HIGH_WATER = 16
AT_ONCE = 16
"""Messages of one source before the others have their turn."""
AHEAD_NS = 200_000_000
"""Recordings that are played as fast as can be stay within so much of each other's times."""


class GatheredSettings(SourceSettings):
    """What the feeder process is told of several sources; nobody configures that."""

    type: Literal["several"] = "several"
    """Which source."""
    endpoints: tuple[str, ...]
    """Where each source process connects."""
    names: tuple[str, ...]
    """What each source is called."""
    lossless: bool
    """Whether all are."""
    in_step: bool
    """Whether all are recordings, whose frames are put in the order of their times."""
    ended: tuple[bool, ...]
    """Which have given all they had."""
    tally: Path
    """Where is counted what has been taken from each, so that its loss on the way is told."""


@dataclass(slots=True)
class _Feed:
    """One of the sources."""

    name: str
    identity: bytes | None = None
    position: dict[str, Any] | None = None
    waiting: deque[tuple[bytes, CsiBlock]] = field(default_factory=deque)
    ended: bool = False
    frames: int = 0
    frame_at: float = 0.0
    heard_at: float = 0.0
    report: dict[str, Any] = field(default_factory=dict)


class Tallies:
    """How many frames have been taken from each source process, in a file that outlives who counts."""

    def __init__(self, path: Path, count: int) -> None:
        if not path.exists():
            path.write_bytes(bytes(16 * count))
        self._counts = np.memmap(path, np.uint64, "r+", shape=(count, 2))

    def of(self, number: int, identity: bytes) -> int:
        """Frames taken from that process."""
        who, taken = self._counts[number]
        return int(taken) if int(who) == _key(identity) else 0

    def set(self, number: int, identity: bytes, taken: int) -> None:
        self._counts[number] = _key(identity), taken


class GatheredSources(Source):
    """Blocks of all sources in the order in which they come, or for recordings of their times.

    A source process that died is followed by another; what the dead one had sent and nobody has taken does
    not count, since its successor sends it again where it can.
    """

    Settings: ClassVar[type[SourceSettings]] = GatheredSettings
    settings: GatheredSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self.lossless = self.settings.lossless
        told = zip(self.settings.names, self.settings.ended, strict=True)
        self._feeds = [_Feed(name, ended=ended) for name, ended in told]
        self._numbering = Numbering()
        self._context: zmq.Context[zmq.Socket[bytes]] | None = None
        self._sockets: list[zmq.Socket[bytes]] = []
        self._began = time.monotonic()

    def open(self) -> None:
        """Let the source processes connect."""
        self._context = zmq.Context()
        self._poller = zmq.Poller()
        self._tallies = Tallies(self.settings.tally, len(self._feeds))
        for endpoint in self.settings.endpoints:
            socket = self._context.socket(zmq.ROUTER)
            socket.set_hwm(HIGH_WATER)
            socket.setsockopt(zmq.ROUTER_HANDOVER, 1)
            socket.bind(endpoint)
            self._sockets.append(socket)
        self._began = time.monotonic()

    def recv(self, timeout: float) -> CsiBlock | None:
        """The next block of any of them.

        Raises
        ------
        EndOfSource
            When all have ended.
        """
        deadline = time.monotonic() + timeout
        while (block := self._next()) is None:
            if all(feed.ended for feed in self._feeds):
                raise EndOfSource
            left = deadline - time.monotonic()
            if left < 0:
                return None
            self._hear(left)
        return block

    def close(self) -> None:
        """Have all source processes end."""
        for feed, socket in zip(self._feeds, self._sockets, strict=False):
            if feed.identity is not None:
                socket.send_multipart([feed.identity, messages.STOP, messages.pack({})], zmq.NOBLOCK)
        self._sockets = []
        if self._context is not None:
            self._context.destroy(linger=1000)
            self._context = None

    def details(self) -> dict[str, Any]:
        """`sources`: one map each {name, frames, quiet_s, silent_s, ended, details}."""
        now = time.monotonic()
        return {
            "sources": [
                {
                    "name": feed.name,
                    "frames": feed.frames,
                    "quiet_s": round(now - (feed.frame_at or self._began), 3),
                    "silent_s": round(now - (feed.heard_at or self._began), 3),
                    "ended": feed.ended,
                    "details": feed.report.get("details", {}),
                }
                for feed in self._feeds
            ]
        }

    def _next(self) -> CsiBlock | None:
        """The block whose turn it is, of those that are there."""
        waiting = [feed for feed in self._feeds if feed.waiting]
        if not waiting:
            return None
        if not self.settings.in_step:
            first = min(waiting, key=lambda one: one.frame_at)
            return self._numbered(first, *first.waiting.popleft())
        if any(not feed.ended and not feed.waiting for feed in self._feeds):
            return None
        first = min(waiting, key=_next_ns)
        others = [_next_ns(feed) for feed in waiting if feed is not first]
        identity, block = first.waiting.popleft()
        until = min(others, default=np.iinfo(np.int64).max - AHEAD_NS) + AHEAD_NS
        stop = int(np.searchsorted(np.maximum.accumulate(block.time_ns), until, "right"))
        if stop < len(block):
            first.waiting.appendleft((identity, block.cut(stop, len(block))))
        return self._numbered(first, identity, block.cut(0, stop))

    def _numbered(self, feed: _Feed, identity: bytes, block: CsiBlock) -> CsiBlock:
        seq = self._numbering.of(block, identity, feed.frames)
        assert seq is not None  # a process sends nothing twice
        feed.frames += len(block)
        return replace(block, seq=seq)

    def _hear(self, timeout: float) -> None:
        """Take what has come, from those of which nothing waits."""
        wanted = [n for n, feed in enumerate(self._feeds) if not feed.waiting]
        for socket in self._sockets:
            self._poller.register(socket, 0)
        for n in wanted:
            self._poller.register(self._sockets[n], zmq.POLLIN)
        ready = dict(self._poller.poll(int(np.ceil(timeout * 1e3))))
        for n in wanted:
            if self._sockets[n] in ready:
                for parts in self._messages(self._sockets[n]):
                    self._take(n, parts)

    def _messages(self, socket: zmq.Socket[bytes]) -> Iterator[list[bytes]]:
        for _ in range(AT_ONCE):
            try:
                yield socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return

    def _take(self, number: int, parts: list[bytes]) -> None:
        feed, (identity, kind, body, *rest) = self._feeds[number], parts
        if feed.identity is None or (kind == messages.HELLO and identity != feed.identity):
            feed.identity = identity
        if identity != feed.identity:
            return  # it is dead, and somebody else has its place
        feed.heard_at = time.monotonic()
        values = messages.unpack(body)
        if kind == messages.HELLO:
            answer = messages.pack({"position": feed.position})
            self._sockets[number].send_multipart([identity, messages.GO, answer])
        elif kind == messages.STATUS:
            self._hear_report(number, feed, values)
        elif kind == messages.BLOCK:
            self._take_block(number, feed, values, rest)

    def _hear_report(self, number: int, feed: _Feed, report: dict[str, Any]) -> None:
        feed.report = report
        self.rejected.merge(report["rejected"])
        if report["complaint"] is not None:
            self.complaint = f"{feed.name}: {report['complaint']}"
        if report["ended"]:
            feed.ended = True
            assert feed.identity is not None
            self._sockets[number].send_multipart([feed.identity, messages.STOP, messages.pack({})])

    def _take_block(self, number: int, feed: _Feed, head: dict[str, Any], parts: list[bytes]) -> None:
        assert feed.identity is not None
        block = decode_csi(parts)
        taken = self._tallies.of(number, feed.identity)
        if lost := head["sent"] - taken:  # an earlier feeder process had it
            self.rejected.add("lost_on_the_way", lost)
        self._tallies.set(number, feed.identity, head["sent"] + len(block))
        feed.position = head["position"]
        feed.frame_at = feed.heard_at
        feed.waiting.append((feed.identity, block))


def _next_ns(feed: _Feed) -> int:
    return int(feed.waiting[0][1].time_ns[0])


def _key(identity: bytes) -> int:
    return int.from_bytes(identity[-8:], "little")
