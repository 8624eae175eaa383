"""Charts over ZeroMQ to whoever subscribes: topics `chart`, `quality`, `status`, `alert`, each `.<array>`."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, ClassVar, Literal

import msgpack
import zmq
from pydantic import Field

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.doorkeeper import Connection, Doorkeeper, key_problems
from chachart.node.net.endpoints import Endpoint, bind, bind_problems, fixed
from chachart.node.net.limits import Refusals
from chachart.node.net.security import SecuritySettings, endpoint_exposure
from chachart.node.net.wire import chart_topic, encode_chart, encode_report
from chachart.sinks.base import NodeAccess, Sink, SinkSettings

ROWS_PER_MESSAGE = 4096
SUBSCRIPTIONS_PER_TICK = 5000
RECEIVE_MESSAGES, RECEIVE_BYTES = 16, 4096
"""ZeroMQ takes in all that has arrived before anybody is counted: of who subscribes too much it is little."""
MAX_SUBSCRIPTION_BYTES = 1024
"""The longest thing that a subscriber sends is its part of the handshake with keys."""
WHOLE_EVERY_S = 1.0
"""The whole chart is put together so often at most, and nobody gets it more often."""
LINGER_MS = 500
_ANY_NUMBER = msgpack.packb(2**64 - 1)


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
        mistakes = endpoint_exposure('sink "publisher"', self.endpoint, security)
        return mistakes + key_problems(self.endpoint, security)


class Publisher(Sink):
    """An XPUB socket: it sees subscribers come, and gives each of them alone the whole chart first.

    Messages are numbered per topic. ZeroMQ drops what a slow subscriber cannot take, and says nothing.
    """

    Settings: ClassVar[type[SinkSettings]] = PublisherSettings
    settings: PublisherSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self.refused = Refusals("publisher")
        self._context: zmq.Context[zmq.Socket[bytes]] | None = None
        self._doorkeeper: Doorkeeper | None = None
        self._node: NodeAccess | None = None
        self._endpoint: str | None = None
        self._seq = {"chart": 0, "quality": 0, "status": 0, "alert": 0}
        self._whole: tuple[bytes, bytes] | None = None
        self._whole_until = 0.0
        self._since: list[ChartUpdate] = []
        self._owed = False
        self._reports_at = 0.0
        self._mixed_up = False
        self._owed_to_all = False

    @classmethod
    def problems(cls, settings: PublisherSettings) -> list[str]:
        """Whether the endpoint is free."""
        return bind_problems(settings.endpoint)

    def open(self, node: NodeAccess | None) -> None:
        """Listen.

        Raises
        ------
        SetupError
            If the endpoint is in use or does not exist here, or the node's keys cannot be read.
        """
        self._node = node
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.XPUB)
        self._socket.set(zmq.XPUB_MANUAL, 1)
        self._socket.xpub_verbose = True
        self._socket.sndhwm = self.settings.queue_messages
        self._socket.rcvhwm, self._socket.rcvbuf = RECEIVE_MESSAGES, RECEIVE_BYTES
        self._socket.maxmsgsize = MAX_SUBSCRIPTION_BYTES
        self._socket.linger = LINGER_MS
        try:
            self._doorkeeper = Doorkeeper(self._context, self.security, self.refused, ("read", "steer"))
            self._doorkeeper.guard(self._socket, self.settings.endpoint)
            self._endpoint = bind(self._socket, self.settings.endpoint)
        except SetupError:
            self.close()
            raise

    def on_chart(self, update: ChartUpdate) -> None:
        """Publish the update, a long one as several messages."""
        if self._whole is not None:
            self._since.append(update)
        for part in update.parts(ROWS_PER_MESSAGE):
            self._send("chart", partial(encode_chart, part))

    def on_quality(self, report: dict[str, Any]) -> None:
        """Publish the report."""
        self._report("quality", report)

    def on_status(self, report: dict[str, Any]) -> None:
        """Publish the report."""
        self._report("status", report)

    def on_alert(self, event: dict[str, Any]) -> None:
        """Publish it."""
        self._report("alert", event)

    def on_tick(self) -> None:
        """Give whoever has subscribed since the last tick what there is: the whole chart, or a report."""
        if self._whole is not None and time.monotonic() >= self._whole_until:
            since, self._whole, self._since = self._since, None, []
            if self._owed and since:
                self.on_chart(ChartUpdate.concatenate(since))
            self._owed = False
        if self._owed_to_all and time.monotonic() >= self._reports_at:
            self._owed_to_all = False
            if self._node is not None and (chart := self._node.chart()) is not None:
                self.on_chart(chart)
            self._send_reports(time.monotonic())
        for _ in range(SUBSCRIPTIONS_PER_TICK):
            if not self._socket.poll(0):
                self._mixed_up = False
                return
            self._hear(self._socket.recv(copy=False))

    def close(self) -> None:
        """Let the last messages go out, half a second at most, and stop listening."""
        if self._doorkeeper is not None:
            self._doorkeeper.close()
            self._doorkeeper = None
        if self._context is not None:
            self._context.destroy()
            self._context = None

    def where(self) -> str | None:
        """The endpoint."""
        return self._endpoint

    def _hear(self, frame: zmq.Frame) -> None:
        """A peer subscribes or unsubscribes; whatever else it sends has it disconnected."""
        assert self._doorkeeper is not None
        kind, topic = frame.bytes[:1], frame.bytes[1:]
        try:
            fd = int(frame.get(zmq.SRCFD))
        except zmq.ZMQError:  # it has gone, and ZeroMQ unsubscribes for it
            return
        connection = self._doorkeeper.connection(fd)
        if kind not in (b"\0", b"\1"):
            self._doorkeeper.expel(fd, "no_subscription")
            self._mixed_up = True
        if self._mixed_up:
            self._adopt_last()
        elif connection is None or connection.expelled:
            return
        elif kind == b"\0":
            connection.topics.discard(topic)
            with suppress(zmq.ZMQError):
                self._socket.set(zmq.UNSUBSCRIBE, topic)
        elif topic not in connection.topics and len(connection.topics) >= self.security.max_subscriptions:
            self._doorkeeper.expel(fd, "too_many_subscriptions")
        else:
            connection.topics.add(topic)
            self._subscribe(connection, topic)

    def _adopt_last(self) -> None:
        """Subscribe the next subscriber to everything, and owe the chart to all.

        XPUB pairs subscriptions with their peers by order, and another message uses up the peer of the
        subscription behind it. That peer can be subscribed just now, before it is known what it wants; it
        drops what it does not.
        """
        self._owed_to_all = True
        with suppress(zmq.ZMQError):  # there is none
            for kind in self._seq:
                self._socket.set(zmq.SUBSCRIBE, self._topic(kind))

    def _subscribe(self, connection: Connection, topic: bytes) -> None:
        """Only what is a beginning of a topic that there is costs anything from now on."""
        kinds = [kind for kind in self._seq if self._topic(kind).startswith(topic)]
        if not kinds:
            return
        with suppress(zmq.ZMQError):  # whoever it was has gone
            self._socket.set(zmq.SUBSCRIBE, topic)
            now = time.monotonic()
            if kinds[0] != "chart":
                self._send_to_newcomer(kinds[0], self._latest(kinds[0]))
            elif now >= connection.whole_at + WHOLE_EVERY_S:
                connection.whole_at = now
                self._send_to_newcomer("chart", self._whole_chart(now))
            if len(kinds) > 1:
                self._send_reports(now)

    def _send_to_newcomer(self, kind: str, body: bytes | None) -> None:
        """To the one peer whose subscription was heard last."""
        if body is None:
            return
        try:
            self._socket.set(zmq.XPUB_MANUAL_LAST_VALUE, 1)
        except zmq.ZMQError:  # a ZeroMQ without it: everybody gets it, and takes it for what it is
            self._socket.send_multipart([self._topic(kind), body])
            return
        try:
            self._socket.send_multipart([self._topic(kind), body])
        finally:
            self._socket.set(zmq.XPUB_MANUAL_LAST_VALUE, 0)
            self._socket.set(zmq.XPUB_MANUAL, 1)

    def _send_reports(self, now: float) -> None:
        """To everybody, at most once a second: a newcomer's one subscription can be answered only once."""
        if self._node is not None and now >= self._reports_at:
            self._reports_at = now + WHOLE_EVERY_S
            if (quality := self._node.quality()) is not None:
                self.on_quality(quality)
            self.on_status(self._node.status())

    def _whole_chart(self, now: float) -> bytes | None:
        """The whole chart as a message; for a second the same, what came since is owed to who gets it."""
        if self._whole is None:
            chart = None if self._node is None else self._node.chart()
            if chart is None:
                return None
            before, _, after = encode_chart(chart, 2**64 - 1).partition(_ANY_NUMBER)
            self._whole = before, after
            self._whole_until = now + WHOLE_EVERY_S
        else:
            self._owed = True
        before, after = self._whole
        return b"".join((before, msgpack.packb(self._before("chart")), after))

    def _latest(self, kind: str) -> bytes | None:
        report = None
        if self._node is not None and kind != "alert":  # what was is no news
            report = self._node.quality() if kind == "quality" else self._node.status()
        if report is None:
            return None
        return encode_report(kind, self.array.name, self._before(kind), time.time_ns(), report)

    def _before(self, kind: str) -> int:
        """The number before the next: what a newcomer gets must not look like a gap, or a start anew."""
        self._seq[kind] = max(self._seq[kind], 1)
        return self._seq[kind] - 1

    def _topic(self, kind: str) -> bytes:
        return chart_topic(self.array.name) if kind == "chart" else f"{kind}.{self.array.name}".encode()

    def _report(self, kind: str, report: dict[str, Any]) -> None:
        now = time.time_ns()
        self._send(kind, lambda seq: encode_report(kind, self.array.name, seq, now, report))

    def _send(self, kind: str, encode: Callable[[int], bytes]) -> None:
        self._socket.send_multipart([self._topic(kind), encode(self._seq[kind])])
        self._seq[kind] += 1
