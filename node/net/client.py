"""For people who subscribe to a node's charts.

    from chachart.node.net.client import subscribe

    with subscribe("tcp://127.0.0.1:5556", array="lab") as charts:
        for update in charts:
            print(len(update), "UEs,", charts.gap, "messages lost before this one", update.x, update.y)

The subscription outlives the node: it connects when the node is there and again when it comes back.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zmq

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.node.net.keys import connect_with
from chachart.node.net.wire import WireError, decode_chart, decode_report

ENDPOINT = "tcp://127.0.0.1:5556"
"""Where the default node publishes."""

_RECONNECT_MS, _RECONNECT_MAX_MS = 100, 2000
_HEARTBEAT_MS, _SILENCE_MS = 2000, 6000
_KINDS = ("chart", "quality", "status", "alert")
KEPT_ALERTS = 1000


def subscribe(
    endpoint: str = ENDPOINT,
    array: str | None = None,
    *,
    timeout: float | None = None,
    queue: int = 1000,
    key: Path | str | None = None,
    server_key: Path | str | None = None,
) -> Subscription:
    """Subscribe to the charts of a node.

    Parameters
    ----------
    endpoint
        Where it publishes.
    array
        Of which array; None for all.
    timeout
        Iterating raises TimeoutError when no chart came for so many seconds; None waits for ever.
    queue
        Messages that may wait here; beyond, they are lost, and `gap` and `lost` tell so.
    key, server_key
        Your `NAME.key_secret` and the node's `node.key`, for a node with keys.

    Raises
    ------
    SetupError
        If `endpoint` is not a ZeroMQ endpoint, or a key cannot be read.
    """
    return Subscription(endpoint, array, timeout=timeout, queue=queue, key=key, server_key=server_key)


class Subscription:
    """Charts as they come, as made by `subscribe`; close it, or use it as a context manager. One thread only.

    Attributes
    ----------
    gap
        Messages lost right before the last chart.
    lost
        Messages lost in all: the node published them and this subscriber was too slow or away.
    restarts
        How often a node began to count anew.
    quality, status
        The last quality and status report by array, None before the first.
    alerts
        The last alerts, oldest first; take them out with `popleft`.
    rejected
        Messages that were not protocol 1, by reason.
    """

    def __init__(
        self,
        endpoint: str,
        array: str | None,
        *,
        timeout: float | None,
        queue: int,
        key: Path | str | None = None,
        server_key: Path | str | None = None,
    ) -> None:
        self.endpoint, self.array, self.timeout = endpoint, array, timeout
        self.gap = self.lost = self.restarts = 0
        self.quality: dict[str, Any] | None = None
        self.status: dict[str, Any] | None = None
        self.alerts: deque[dict[str, Any]] = deque(maxlen=KEPT_ALERTS)
        self.rejected = Counters()
        self._next: dict[bytes, int] = {}
        self._context = zmq.Context()
        self._socket: zmq.Socket[bytes] = self._context.socket(zmq.SUB)
        options = {
            zmq.RCVHWM: queue,
            zmq.LINGER: 0,
            zmq.RECONNECT_IVL: _RECONNECT_MS,
            zmq.RECONNECT_IVL_MAX: _RECONNECT_MAX_MS,
            zmq.HEARTBEAT_IVL: _HEARTBEAT_MS,
            zmq.HEARTBEAT_TIMEOUT: _SILENCE_MS,
        }
        for option, value in options.items():
            self._socket.set(option, value)
        for kind in _KINDS:
            self._socket.subscribe(f"{kind}.{array or ''}")
        try:
            connect_with(self._socket, key, server_key)
            self._socket.ipv6 = "[" in endpoint
            self._socket.connect(endpoint)
        except SetupError:
            self.close()
            raise
        except zmq.ZMQError as error:
            self.close()
            hint = "it must look like tcp://127.0.0.1:5556"
            raise SetupError(
                f"{endpoint} is no endpoint to subscribe to ({error.strerror}); {hint}"
            ) from None

    def recv(self, timeout: float | None = None) -> ChartUpdate | None:
        """The next chart; None if none came within `timeout` seconds (None waits for ever)."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            left_ms = None if deadline is None else max(0, round(1000 * (deadline - time.monotonic())))
            if not self._socket.poll(left_ms):
                return None
            update = self._accept(self._socket.recv_multipart())
            if update is not None:
                return update
            if deadline is not None and time.monotonic() >= deadline:
                return None

    def __iter__(self) -> Iterator[ChartUpdate]:
        while True:
            update = self.recv(self.timeout)
            if update is None:
                raise TimeoutError(f"no chart from {self.endpoint} for {self.timeout:g} s")
            yield update

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self._socket.close()
        self._context.term()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _accept(self, parts: list[bytes]) -> ChartUpdate | None:
        try:
            if len(parts) != 2:
                raise WireError("parts", f"a report has 2 parts, not {len(parts)}")
            topic, body = parts
            kind, _, array = topic.partition(b".")
            # A subscription is a prefix: lab would also bring lab2.
            if self.array is not None and array != self.array.encode():
                return None
            if kind == b"quality":
                self.quality = decode_report("quality", body)
            elif kind == b"status":
                self.status = decode_report("status", body)
            elif kind == b"alert":
                self.alerts.append(decode_report("alert", body))
            else:
                seq, update = decode_chart(body)
                self._count(topic, seq)
                return update
        except WireError as error:
            self.rejected.add(error.reason)
        return None

    def _count(self, topic: bytes, seq: int) -> None:
        expected = self._next.get(topic, seq)
        self._next[topic] = seq + 1
        self.gap = max(0, seq - expected)
        self.lost += self.gap
        self.restarts += seq < expected
