"""Floods: what strangers on this machine could throw at a node's sockets, each from a process of its own.

A flood goes on for so many seconds, one of mutated inputs until so many were thrown if that is asked for; it
gives back how many things it threw.
"""

from __future__ import annotations

import base64
import http.client
import os
import socket as socketlib
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import zmq

from chachart.node.commands.benchmarks.attack_inputs import block
from chachart.node.commands.benchmarks.mutations import mutations
from chachart.node.data.csi import CsiBlock
from chachart.node.net.wire import encode_csi

FRAMES, PACE_S = 20, 0.02
"""The honest producer's block, and how often it sends one: 1000 frames a second."""
HONEST = 1 << 40
"""Its UEs are numbered from here; no flood uses such numbers."""
HONEST_QUEUE = 10
MOST_SOCKETS = 2000
THREADS, ANSWER_S = 32, 0.02
MESSAGES_EACH = 100
"""A WebSocket viewer may send so many at once before it has to wait; then another comes."""
LINGER_MS = 1000
_HERE = "127.0.0.1"
_ENDLESS = 1 << 40


@dataclass(frozen=True, slots=True)
class Ports:
    """Where the node's `zmq` source, publisher, control and view listen."""

    source: int
    charts: int
    control: int
    web: int


@dataclass(frozen=True, slots=True)
class Task:
    """What a flood aims at, and when it is over."""

    ports: Ports
    until: float
    inputs: int
    seed: int = 0

    def mutated(self, *samples: bytes) -> Iterator[bytes]:
        """Inputs as long as the flood goes on."""
        for n, data in enumerate(mutations(samples, self.seed, 0, _ENDLESS)):
            if n >= self.inputs or (n % 64 == 0 and time.time() >= self.until):
                return
            yield data

    def goes_on(self) -> bool:
        """Whether there is time left."""
        return time.time() < self.until


def feed(port: int) -> None:
    """Send good frames for as long as the process lives."""
    ue = HONEST + np.arange(FRAMES, dtype=np.uint64)
    csi = np.ones((FRAMES, 2, 3), np.complex64)
    seq, due = 0, time.monotonic()
    with zmq.Context() as context, context.socket(zmq.PUSH) as socket:
        socket.linger, socket.sndhwm = 0, HONEST_QUEUE
        socket.connect(f"tcp://{_HERE}:{port}")
        while True:
            now = np.full(FRAMES, time.time_ns())
            with suppress(zmq.Again):
                socket.send_multipart(encode_csi(CsiBlock("lab", seq, ue, now, csi)), zmq.NOBLOCK)
            seq += FRAMES
            due += PACE_S
            time.sleep(max(0.0, due - time.monotonic()))


@contextmanager
def _socket(context: zmq.Context[Any], kind: int, port: int) -> Iterator[zmq.Socket[bytes]]:
    with context.socket(kind) as socket:
        socket.linger, socket.sndtimeo = LINGER_MS, 100
        socket.connect(f"tcp://{_HERE}:{port}")
        yield socket


def _stranger(n: int) -> tuple[str, int]:
    """Where HTTP floods come from, so that they do not use up what honest people may ask."""
    return f"127.0.0.{2 + n % 250}", 0


def _subscriptions(task: Task) -> int:
    """One subscriber that subscribes to everything that is not there."""
    n = 0
    with zmq.Context() as context, _socket(context, zmq.SUB, task.ports.charts) as socket:
        while task.goes_on():
            for _ in range(64):
                socket.subscribe(f"chart.{n}")
                n += 1
            socket.poll(0)
    return n


def _connections(task: Task) -> int:
    """TCP connections to every port, which say nothing."""
    held: list[socketlib.socket] = []
    ports = (task.ports.source, task.ports.charts, task.ports.control, task.ports.web)
    n = 0
    while task.goes_on():
        with suppress(OSError):
            held.append(socketlib.create_connection((_HERE, ports[n % 4]), 1.0, _stranger(0)))
        n += 1
        if len(held) >= MOST_SOCKETS:
            held.pop(0).close()
    for one in held:
        one.close()
    return n


def _producers(task: Task) -> int:
    """Producers by the hundred, each of which sends a block and goes."""
    n, parts = 0, encode_csi(block(1))
    while task.goes_on():
        with zmq.Context() as context:
            sockets = [context.socket(zmq.PUSH) for _ in range(400)]
            for socket in sockets:
                socket.linger = 0
                socket.connect(f"tcp://{_HERE}:{task.ports.source}")
            for socket in sockets:
                with suppress(zmq.Again):
                    socket.send_multipart(parts, zmq.NOBLOCK)
            n += len(sockets)
            time.sleep(min(1.0, max(0.0, task.until - time.time())))
            context.destroy(linger=0)
    return n


def _pushed(task: Task, port: int, messages: Iterator[list[Any]], kind: int = zmq.PUSH) -> int:
    n = 0
    with zmq.Context() as context, _socket(context, kind, port) as socket:
        for message in messages:
            while task.goes_on():
                while kind == zmq.DEALER and socket.poll(0):  # unread answers would stop the requests
                    socket.recv_multipart()
                try:
                    socket.send_multipart(message)
                except zmq.Again:
                    continue
                n += 1
                break
    return n


def _ues(task: Task) -> int:
    """Frames of UEs that nobody has seen before, each with another number."""
    csi = np.ones((FRAMES, 2, 3), np.complex64)

    def strangers() -> Iterator[list[Any]]:
        seq = 0
        while task.goes_on():
            ue = np.arange(1000 + seq, 1000 + seq + FRAMES, dtype=np.uint64)
            yield list(encode_csi(CsiBlock("lab", seq, ue, np.full(FRAMES, time.time_ns()), csi)))
            seq += FRAMES

    return _pushed(task, task.ports.source, strangers())


def _messages(task: Task) -> int:
    """Mutated blocks to the source."""
    samples = {n: list(map(bytes, encode_csi(block(n)))) for n in (1, 3)}
    bodies = [samples[n][1] for n in (1, 3)]
    headers = task.mutated(*(samples[n][0] for n in (1, 3)))
    return _pushed(task, task.ports.source, ([header, bodies[n % 2]] for n, header in enumerate(headers)))


def _asking(task: Task) -> int:
    """Mutated requests to control."""
    asked = task.mutated(b'{"op": "spectrum", "ue": 7}', b'{"op": "replay", "paused": true}')
    return _pushed(task, task.ports.control, ([b"", one] for one in asked), zmq.DEALER)


def _subscribing(task: Task) -> int:
    """Mutated subscriptions to the publisher."""
    asked = task.mutated(b"\1chart.lab", b"\1status.lab", b"\0chart.lab")
    return _pushed(task, task.ports.charts, ([one] for one in asked), zmq.XSUB)


def _requests(task: Task) -> int:
    """Whole charts over HTTP, as fast as they come."""
    n = 0
    while task.goes_on():
        connection = http.client.HTTPConnection(_HERE, task.ports.web, 10, _stranger(0))
        with suppress(OSError, http.client.HTTPException):
            connection.request("GET", "/api/chart")
            connection.getresponse().read()
        connection.close()
        n += 1
    return n


def _http(task: Task) -> int:
    """Mutated requests over HTTP, from many addresses."""
    end = b" HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 3\r\nOrigin: http://127.0.0.1\r\n\r\nabc"
    samples = (b"GET /api/spectrum?ue=7" + end, b"POST /login" + end, b"GET /recordings?name=a.mcap" + end)
    return _connected(task, (task.ports.web,), samples)


def _handshakes(task: Task) -> int:
    """Mutated ZeroMQ handshakes."""
    greeting = b"\xff\0\0\0\0\0\0\0\1\x7f\3\0NULL" + bytes(48)
    ready = b"\4\x19\5READY\x0bSocket-Type\0\0\0\4"
    ports = (task.ports.source, task.ports.charts, task.ports.control)
    return _connected(task, ports, tuple(greeting + ready + kind for kind in (b"PUSH", b"SUB\0", b"REQ\0")))


def _connected(task: Task, ports: tuple[int, ...], samples: tuple[bytes, ...]) -> int:
    """One connection an input, some tens at a time, each closed when an answer or nothing has come."""

    def throw(n: int, data: bytes) -> bool:
        """Whether it got there; no answer is one too."""
        try:
            socket = socketlib.create_connection((_HERE, ports[n % len(ports)]), 5.0, _stranger(n))
        except OSError:
            return False
        with socket, suppress(OSError):
            socket.sendall(data)
            socket.settimeout(ANSWER_S)
            socket.recv(4096)
        return True

    inputs, begun, thrown = task.mutated(*samples), 0, 0
    with ThreadPoolExecutor(THREADS) as pool:
        while batch := list(islice(inputs, 64 * THREADS)):
            thrown += sum(pool.map(throw, range(begun, begun + len(batch)), batch))
            begun += len(batch)
    return thrown


def _websocket(task: Task) -> int:
    """Mutated messages over WebSocket, every tenth of them mutated as a frame."""
    asked = task.mutated(b'{"id": 1, "op": "spectrum", "ue": 7}', b'{"id": 2, "op": "past", "ago_s": 3}')
    odd = mutations([_framed(b'{"id": 3, "op": "sync"}')], task.seed, 0, _ENDLESS)
    n = 0
    while batch := list(islice(asked, MESSAGES_EACH)):
        frames = [next(odd) if k % 10 == 9 else _framed(one) for k, one in enumerate(batch)]
        with (
            suppress(OSError),
            socketlib.create_connection((_HERE, task.ports.web), 5.0, _stranger(n)) as one,
        ):
            key = base64.b64encode(os.urandom(16)).decode()
            words = f"Host: {_HERE}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13"
            one.sendall(f"GET /ws HTTP/1.1\r\n{words}\r\nSec-WebSocket-Key: {key}\r\n\r\n".encode())
            one.recv(65536)
            one.sendall(b"".join(frames))
            one.settimeout(0.05)
            while one.recv(65536):
                pass
        n += len(batch)
    return n


def _framed(text: bytes) -> bytes:
    """A WebSocket text message as a client sends it, with a mask of zeros."""
    size = min(len(text), 125)
    return bytes((0x81, 0x80 | size, 0, 0, 0, 0)) + text[:size]


FLOODS: dict[str, Callable[[Task], int]] = {
    "subscriptions": _subscriptions,
    "connections": _connections,
    "producers": _producers,
    "ues": _ues,
    "requests": _requests,
    "mutated blocks": _messages,
    "mutated subscriptions": _subscribing,
    "mutated requests": _asking,
    "mutated http": _http,
    "mutated websocket": _websocket,
    "mutated handshakes": _handshakes,
}
MUTATED = tuple(name for name in FLOODS if name.startswith("mutated"))


def flood(name: str, ports: Ports, seconds: float, inputs: int) -> int:
    """Throw until the time is over, or so many mutated inputs have been thrown; how many it were."""
    return FLOODS[name](Task(ports, time.time() + seconds, inputs))
