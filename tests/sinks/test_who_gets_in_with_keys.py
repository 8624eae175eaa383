"""Every ZeroMQ socket, from this machine and from elsewhere, by everybody with and without a key.

What each key may do over `control`, and keys taken away, are in tests/node/net/test_keys.py.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
import zmq
from chart_samples import QUALITY, StillNode, some_chart
from csi_samples import small_array, some_block
from live_node import other_address

from chachart.node.net.keys import allow, connect_with, new_pair
from chachart.node.net.security import SecuritySettings
from chachart.node.net.wire import encode_csi
from chachart.sinks.base import Sink
from chachart.sinks.control import Control, ControlSettings
from chachart.sinks.publisher import Publisher, PublisherSettings
from chachart.sources.zmq import ZmqSettings, ZmqSource

DEADLINE_S, REFUSED_S = 60.0, 0.7
"""Whoever is refused gets nothing for so long."""
RIGHTS = {"reader": "read", "steerer": "steer", "sender": "send"}
WHO = ("no key", "wrong key", *RIGHTS)
SOCKETS = {
    "publisher": ("reader", "steerer"),
    "control": ("reader", "steerer"),
    "source": ("sender",),
}
"""Which keys let in where."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The node's keys; everybody has a pair, and only some are allowed."""
    folder = tmp_path_factory.mktemp("keys")
    new_pair(folder / "keys", "node")
    for name in (*RIGHTS, "wrong key"):
        public, _ = new_pair(folder, name.replace(" ", "-"))
        if name in RIGHTS:
            allow(folder / "keys", public, RIGHTS[name])  # type: ignore[arg-type]
    return folder


@contextmanager
def asker(kind: int, where: str, folder: Path, who: str) -> Iterator[zmq.Socket[bytes]]:
    with zmq.Context() as context, context.socket(kind) as socket:
        socket.linger = 0
        if who != "no key":
            key = folder / f"{who.replace(' ', '-')}.key_secret"
            connect_with(socket, key=key, server_key=folder / "keys" / "node.key")
        socket.connect(where)
        yield socket


def happens(poll: Callable[[], Any], expected: bool) -> bool:
    """Whether something comes of it: at once by right, never otherwise."""
    deadline = time.monotonic() + (DEADLINE_S if expected else REFUSED_S)
    while time.monotonic() < deadline:
        if poll():
            return True
    return False


def gets_in(name: str, endpoint: str, security: SecuritySettings, folder: Path, who: str, due: bool) -> bool:
    if name == "source":
        source = ZmqSource(ZmqSettings(endpoint=endpoint), small_array())
        source.security = security
        with source, asker(zmq.PUSH, source.details()["endpoint"], folder, who) as producer:

            def arrives() -> bool:
                with suppress(zmq.Again):
                    producer.send_multipart(encode_csi(some_block(3)), zmq.NOBLOCK)
                return source.recv(0.02) is not None

            return happens(arrives, due)
    sink: Sink = (
        Publisher(PublisherSettings(endpoint=endpoint), small_array())
        if name == "publisher"
        else Control(ControlSettings(endpoint=endpoint), small_array())
    )
    sink.security = security
    sink.open(StillNode(some_chart(5, seed=4), QUALITY))
    try:
        with asker(zmq.SUB if name == "publisher" else zmq.DEALER, sink.where() or "", folder, who) as socket:
            if name == "publisher":
                socket.subscribe(b"chart.lab")
            else:
                with suppress(zmq.Again):
                    socket.sndtimeo = int(1e3 * (DEADLINE_S if due else REFUSED_S))
                    socket.send_multipart([b"", json.dumps({"op": "nothing"}).encode()])

            def answered() -> bool:
                sink.on_tick()
                return bool(socket.poll(20))

            return happens(answered, due)
    finally:
        sink.close()


@pytest.mark.parametrize("trust_local", [False, True])
@pytest.mark.parametrize("remote", [False, True])
@pytest.mark.parametrize("name", SOCKETS)
def test_keys(folder: Path, name: str, remote: bool, trust_local: bool) -> None:
    host = other_address() if remote else "127.0.0.1"
    if host is None:
        pytest.skip("this machine has no address but loopback")
    security = SecuritySettings(keys=folder / "keys", trust_local=trust_local)
    for who in WHO:
        due = who in SOCKETS[name]
        if trust_local and not remote:  # the socket asks nobody for a key, and speaks without
            if who != "no key":
                continue
            due = True
        assert gets_in(name, f"tcp://{host}:0", security, folder, who, due) is due, who
