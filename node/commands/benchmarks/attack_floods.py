"""A node to attack, and floods: what strangers on this machine could throw at its sockets."""

from __future__ import annotations

import http.client
import json
import socket as socketlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import zmq

from chachart.node.commands.benchmarks.attack_inputs import block
from chachart.node.commands.benchmarks.damage_worker import mutated
from chachart.node.commands.benchmarks.running import RunningNode
from chachart.node.data.csi import CsiBlock
from chachart.node.net.wire import encode_csi

FRAMES, PACE_S = 20, 0.02
"""The good producer's block, and how often it sends one: 1000 frames a second."""
MOST_SOCKETS = 2000
STRANGER = "127.0.0.2"
"""Where HTTP floods come from, so that they do not use up what others may ask."""
START_WITHIN_S = 60.0

Flood = Callable[[float], int]


class Target:
    """Ports of a node on loopback, and who feeds and watches it."""

    def __init__(self) -> None:
        self.source, self.charts, self.control, self.web = (_free_port() for _ in range(4))

    def config(self) -> str:
        """The node's configuration: a `zmq` source, and every sink that listens."""
        return f"""
            [array]
            antennas = 2
            subcarriers = 3
            subcarrier_spacing_hz = 312500.0
            [source]
            type = "zmq"
            endpoint = "tcp://127.0.0.1:{self.source}"
            [estimator]
            max_ues = 2000
            [[sinks]]
            type = "publisher"
            endpoint = "tcp://127.0.0.1:{self.charts}"
            [[sinks]]
            type = "control"
            endpoint = "tcp://127.0.0.1:{self.control}"
            [[sinks]]
            type = "view"
            port = {self.web}
        """

    @contextmanager
    def fed(self, node: RunningNode) -> Iterator[None]:
        """Feed it from now on; it charts when this begins."""
        over = threading.Event()
        feeder = threading.Thread(target=self._feed, args=(over,), daemon=True)
        feeder.start()
        try:
            deadline = time.monotonic() + START_WITHIN_S
            while time.monotonic() < deadline:
                node.rest(0.2)
                with suppress(OSError, ValueError, KeyError):
                    if self.status()["frames_estimated"]:
                        break
            yield
        finally:
            over.set()
            feeder.join()

    def status(self) -> dict[str, Any]:
        """The node's status, asked as a person on this machine would."""
        connection = http.client.HTTPConnection("127.0.0.1", self.web, timeout=30)
        try:
            connection.request("GET", "/api/status")
            answer: dict[str, Any] = json.loads(connection.getresponse().read())
        finally:
            connection.close()
        return answer

    @staticmethod
    def refused(status: dict[str, Any]) -> int:
        """How many peers, requests and messages were turned away."""
        counts = [sink["refused"] for sink in status["sinks"]] + [status["source_details"]["refused"]]
        return sum(sum(reasons.values()) for reasons in [*counts, status["rejected"]])

    def _feed(self, over: threading.Event) -> None:
        ue = np.arange(FRAMES, dtype=np.uint64)
        csi = np.ones((FRAMES, 2, 3), np.complex64)
        seq = 0
        with zmq.Context() as context, context.socket(zmq.PUSH) as socket:
            socket.linger = 0
            socket.connect(f"tcp://127.0.0.1:{self.source}")
            while not over.wait(PACE_S):
                now = np.full(FRAMES, time.time_ns())
                with suppress(zmq.Again):
                    socket.send_multipart(encode_csi(CsiBlock("lab", seq, ue, now, csi)), zmq.NOBLOCK)
                seq += FRAMES


def _free_port() -> int:
    with socketlib.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
        return port


def _subscriptions(target: Target) -> Flood:
    """One subscriber that subscribes to everything that is not there."""

    def flood(until: float) -> int:
        n = 0
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.linger = 0
            socket.connect(f"tcp://127.0.0.1:{target.charts}")
            while time.monotonic() < until:
                socket.subscribe(f"chart.{n}")
                n += 1
                socket.poll(0)
        return n

    return flood


def _connections(target: Target) -> Flood:
    """TCP connections to every port, which say nothing."""

    def flood(until: float) -> int:
        held: list[socketlib.socket] = []
        ports = (target.source, target.charts, target.control, target.web)
        n = 0
        while time.monotonic() < until:
            with suppress(OSError):
                held.append(socketlib.create_connection(("127.0.0.1", ports[n % 4]), 1.0, (STRANGER, 0)))
            n += 1
            if len(held) >= MOST_SOCKETS:
                held.pop(0).close()
        for one in held:
            one.close()
        return n

    return flood


def _producers(target: Target) -> Flood:
    """Producers by the hundred, each of which sends a block and goes."""

    def flood(until: float) -> int:
        n = 0
        parts = encode_csi(block(1))
        while time.monotonic() < until:
            with zmq.Context() as context:
                sockets = [context.socket(zmq.PUSH) for _ in range(400)]
                for socket in sockets:
                    socket.linger = 0
                    socket.connect(f"tcp://127.0.0.1:{target.source}")
                for socket in sockets:
                    with suppress(zmq.Again):
                        socket.send_multipart(parts, zmq.NOBLOCK)
                n += len(sockets)
                time.sleep(min(1.0, max(0.0, until - time.monotonic())))
                context.destroy(linger=0)
        return n

    return flood


def _pushed(target: Target, until: float, make: Callable[[int], list[Any]]) -> int:
    n = 0
    with zmq.Context() as context, context.socket(zmq.PUSH) as socket:
        socket.linger, socket.sndtimeo = 0, 100
        socket.connect(f"tcp://127.0.0.1:{target.source}")
        while time.monotonic() < until:
            with suppress(zmq.Again):
                socket.send_multipart(make(n))
                n += 1
    return n


def _ues(target: Target) -> Flood:
    """Frames of UEs that nobody has seen before, each with another number."""
    csi = np.ones((FRAMES, 2, 3), np.complex64)

    def make(n: int) -> list[Any]:
        ue = np.arange(1000 + n * FRAMES, 1000 + (n + 1) * FRAMES, dtype=np.uint64)
        return list(encode_csi(CsiBlock("lab", n * FRAMES, ue, np.full(FRAMES, time.time_ns()), csi)))

    return lambda until: _pushed(target, until, make)


def _messages(target: Target) -> Flood:
    """Mutated blocks to the source."""
    samples = [list(map(bytes, encode_csi(block(n)))) for n in (1, 3)]
    rng = np.random.default_rng(0)

    def make(n: int) -> list[Any]:
        header, csi = samples[n % 2]
        return [mutated(header, rng), csi]

    return lambda until: _pushed(target, until, make)


def _requests(target: Target) -> Flood:
    """Whole charts over HTTP, as fast as they come."""

    def flood(until: float) -> int:
        n = 0
        while time.monotonic() < until:
            connection = http.client.HTTPConnection("127.0.0.1", target.web, 10, (STRANGER, 0))
            with suppress(OSError, http.client.HTTPException):
                connection.request("GET", "/api/chart")
                connection.getresponse().read()
            connection.close()
            n += 1
        return n

    return flood


def _bytes(target: Target) -> Flood:
    """Mutated requests over HTTP, and anything to the ZeroMQ sockets."""
    rng = np.random.default_rng(1)
    sample = (
        b"POST /api/method?theta=music&rho=music HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 3\r\n\r\nabc"
    )
    greeting = b"\xff\0\0\0\0\0\0\0\1\x7f\3\0NULL" + bytes(48) + b"\4\x19\5READY\x0bSocket-Type\0\0\0\4PUSH"
    ports = (target.web, target.source, target.charts, target.control)

    def flood(until: float) -> int:
        n = 0
        while time.monotonic() < until:
            port = ports[n % 4]
            data = mutated(sample if port == target.web else greeting, rng)
            address = ("127.0.0.1", port)
            with suppress(OSError), socketlib.create_connection(address, 1.0, (STRANGER, 0)) as socket:
                socket.sendall(data)
            n += 1
        return n

    return flood


def _asking(target: Target) -> Flood:
    """Mutated requests to control."""
    rng = np.random.default_rng(2)

    def flood(until: float) -> int:
        n = 0
        with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
            socket.linger, socket.sndtimeo = 0, 100
            socket.connect(f"tcp://127.0.0.1:{target.control}")
            while time.monotonic() < until:
                with suppress(zmq.Again):
                    socket.send_multipart([b"", mutated(b'{"op": "spectrum", "ue": 7}', rng)])
                    n += 1
                while socket.poll(0):
                    socket.recv_multipart()
        return n

    return flood


FLOODS: dict[str, Callable[[Target], Flood]] = {
    "subscriptions": _subscriptions,
    "connections": _connections,
    "producers": _producers,
    "ues": _ues,
    "messages": _messages,
    "requests": _requests,
    "bytes": _bytes,
    "control": _asking,
}
