"""Charts over ZeroMQ to whoever subscribes: topics `chart.<array>`, `quality.<array>`, `status.<array>`."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Literal

import zmq
from pydantic import Field

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.endpoints import Endpoint, bind, bind_problems, fixed
from chachart.node.net.security import SecuritySettings, endpoint_exposure
from chachart.node.net.wire import chart_topic, encode_chart, encode_report
from chachart.sinks.base import NodeAccess, Sink, SinkSettings

ROWS_PER_MESSAGE = 4096
SUBSCRIPTIONS_PER_TICK = 1000
MAX_SUBSCRIPTION_BYTES = 1024
LINGER_MS = 500


class PublisherSettings(SinkSettings):
    """`type = "publisher"`: charts, quality and status by ZeroMQ, protocol 1."""

    type: Literal["publisher"] = "publisher"
    endpoint: Endpoint = "tcp://127.0.0.1:5556"
    """Where subscribers connect."""
    queue_messages: int = Field(256, ge=16, le=65536)
    """Messages that may wait for each subscriber; a slower one loses some and sees it by their numbers."""

    def listens_on(self) -> str | None:
        """Its endpoint, unless any free one will do."""
        return fixed(self.endpoint)

    def exposure(self, security: SecuritySettings) -> list[str]:
        """An endpoint that other machines reach needs keys."""
        return endpoint_exposure('sink "publisher"', self.endpoint, security)


class Publisher(Sink):
    """An XPUB socket: it sees subscribers come, and gives them the whole chart first.

    Messages are numbered per topic. ZeroMQ drops what a slow subscriber cannot take, and says nothing.
    """

    Settings: ClassVar[type[SinkSettings]] = PublisherSettings
    settings: PublisherSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._context: zmq.Context[zmq.Socket[bytes]] | None = None
        self._node: NodeAccess | None = None
        self._endpoint: str | None = None
        self._seq = {"chart": 0, "quality": 0, "status": 0}

    @classmethod
    def problems(cls, settings: PublisherSettings) -> list[str]:
        """Whether the endpoint is free."""
        return bind_problems(settings.endpoint)

    def open(self, node: NodeAccess | None) -> None:
        """Listen.

        Raises
        ------
        SetupError
            If the endpoint is in use or does not exist here.
        """
        self._node = node
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.XPUB)
        self._socket.xpub_verbose = True
        self._socket.sndhwm = self.settings.queue_messages
        self._socket.maxmsgsize = MAX_SUBSCRIPTION_BYTES
        self._socket.linger = LINGER_MS
        try:
            self._endpoint = bind(self._socket, self.settings.endpoint)
        except SetupError:
            self.close()
            raise

    def on_chart(self, update: ChartUpdate) -> None:
        """Publish the update, a long one as several messages."""
        for part in update.parts(ROWS_PER_MESSAGE):
            self._send("chart", partial(encode_chart, part))

    def on_quality(self, report: dict[str, Any]) -> None:
        """Publish the report."""
        self._report("quality", report)

    def on_status(self, report: dict[str, Any]) -> None:
        """Publish the report."""
        self._report("status", report)

    def on_tick(self) -> None:
        """Give whoever subscribed since the last tick what there is: the whole chart, quality and status."""
        prefixes = self._new_subscriptions()
        if not prefixes or self._node is None:
            return
        if _matches(prefixes, self._topic("chart")) and (chart := self._node.chart()) is not None:
            self.on_chart(chart)
        if _matches(prefixes, self._topic("quality")) and (report := self._node.quality()) is not None:
            self.on_quality(report)
        if _matches(prefixes, self._topic("status")):
            self.on_status(self._node.status())

    def close(self) -> None:
        """Let the last messages go out, half a second at most, and stop listening."""
        if self._context is not None:
            self._context.destroy()
            self._context = None

    def where(self) -> str | None:
        """The endpoint."""
        return self._endpoint

    def _new_subscriptions(self) -> set[bytes]:
        """Prefixes that somebody subscribed to; whatever else subscribers send means nothing."""
        prefixes = set()
        for _ in range(SUBSCRIPTIONS_PER_TICK):
            if not self._socket.poll(0):
                break
            message = self._socket.recv_multipart()[0]
            if message.startswith(b"\x01"):
                prefixes.add(message[1:])
        return prefixes

    def _topic(self, kind: str) -> bytes:
        return chart_topic(self.array.name) if kind == "chart" else f"{kind}.{self.array.name}".encode()

    def _report(self, kind: str, report: dict[str, Any]) -> None:
        now = time.time_ns()
        self._send(kind, lambda seq: encode_report(kind, self.array.name, seq, now, report))

    def _send(self, kind: str, encode: Callable[[int], bytes]) -> None:
        self._socket.send_multipart([self._topic(kind), encode(self._seq[kind])])
        self._seq[kind] += 1


def _matches(prefixes: set[bytes], topic: bytes) -> bool:
    return any(topic.startswith(prefix) for prefix in prefixes)
