"""Who gets in with which key, over real sockets; who is one too many; who is shown the door."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
import zmq
from chart_samples import QUALITY, StillNode, some_chart
from csi_samples import small_array, some_block

from chachart.node.commands.ctl import ask
from chachart.node.commands.main import main
from chachart.node.data.errors import EX_CONFIG, RequestError, SetupError
from chachart.node.net.client import subscribe
from chachart.node.net.keys import KeyPair, KeyRing, allow, connect_with, load_public, new_pair
from chachart.node.net.security import SecuritySettings
from chachart.node.net.wire import encode_csi
from chachart.sinks.base import Sink
from chachart.sinks.control import Control, ControlSettings
from chachart.sinks.publisher import Publisher, PublisherSettings
from chachart.sources.zmq import ZmqSettings, ZmqSource

DEADLINE_S = 20.0
REFUSED_S = 1.0
"""Whoever is refused gets nothing for so long; who is let in gets something within milliseconds."""


class IdleNode(StillNode):
    """One that records nothing."""

    def stop_recording(self) -> dict[str, Any]:
        raise RequestError("no recording is running")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Keys of a node, and of people with one right each; `eve` has a key and no right."""
    keys = tmp_path / "keys"
    new_pair(keys, "node")
    for name, right in (("ana", "read"), ("bob", "steer"), ("cam", "send")):
        public, _ = new_pair(tmp_path, name)
        allow(keys, public, right)  # type: ignore[arg-type]
    new_pair(tmp_path, "eve")
    return keys


def key_of(folder: Path, name: str) -> dict[str, Path]:
    return {"key": folder.parent / f"{name}.key_secret", "server_key": folder / "node.key"}


def secured(folder: Path, **changes: Any) -> SecuritySettings:
    return SecuritySettings(keys=folder, **changes)


@contextmanager
def running(sink: Sink, security: SecuritySettings) -> Iterator[str]:
    """The endpoint of a sink that ticks while it is used, by the functions below."""
    sink.security = security
    sink.open(IdleNode(some_chart(20, seed=4), QUALITY))
    try:
        where = sink.where()
        assert where is not None
        yield where
    finally:
        sink.close()


def comes(tick: Callable[[], Any], there: Callable[[], Any], within_s: float) -> bool:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        tick()
        if there():
            return True
    return False


def publisher(endpoint: str = "tcp://127.0.0.1:0") -> Publisher:
    return Publisher(PublisherSettings(endpoint=endpoint), small_array())


@pytest.mark.parametrize(
    ("name", "gets_in"), [("ana", True), ("bob", True), ("cam", False), ("eve", False), (None, False)]
)
def test_subscribers_need_a_key_that_may_read(folder: Path, name: str | None, gets_in: bool) -> None:
    sink = publisher()
    keys = key_of(folder, name) if name else {}
    with running(sink, secured(folder)) as where, subscribe(where, **keys) as charts:
        got = comes(sink.on_tick, lambda: charts.recv(0.02), DEADLINE_S if gets_in else REFUSED_S)
        assert got is gets_in
        if name in ("cam", "eve"):
            assert set(sink.refused.as_dict()) == {"unknown_key"}


def test_a_wrong_key_of_the_node_is_noticed_by_the_subscriber(folder: Path) -> None:
    sink = publisher()
    keys = key_of(folder, "ana") | {"server_key": folder.parent / "eve.key"}
    with running(sink, secured(folder)) as where, subscribe(where, **keys) as charts:
        assert not comes(sink.on_tick, lambda: charts.recv(0.02), REFUSED_S)


def test_keys_are_added_and_taken_away_while_the_node_runs(folder: Path) -> None:
    sink = publisher()
    with running(sink, secured(folder)) as where:
        allow(folder, folder.parent / "eve.key", "read")
        (folder / "read" / "ana.key").unlink()
        with subscribe(where, **key_of(folder, "eve")) as charts:
            assert comes(sink.on_tick, lambda: charts.recv(0.02), DEADLINE_S)
        with subscribe(where, **key_of(folder, "ana")) as charts:
            assert not comes(sink.on_tick, lambda: charts.recv(0.02), REFUSED_S)


def test_local_people_are_trusted_when_told_so(folder: Path, tmp_path: Path) -> None:
    for endpoint in ("tcp://127.0.0.1:0", f"ipc://{tmp_path}/chart"):
        sink = publisher(endpoint)
        with running(sink, secured(folder, trust_local=True)) as where, subscribe(where) as charts:
            assert comes(sink.on_tick, lambda: charts.recv(0.02), DEADLINE_S)


@pytest.mark.parametrize(
    ("name", "reads", "steers"),
    [("ana", True, False), ("bob", True, True), ("cam", False, False), (None, False, False)],
)
def test_control_does_what_the_key_may(folder: Path, name: str | None, reads: bool, steers: bool) -> None:
    sink = Control(ControlSettings(endpoint="tcp://127.0.0.1:0"), small_array())
    keys = key_of(folder, name) if name else {}
    with running(sink, secured(folder)) as where:
        over = threading.Event()

        def serve() -> None:
            while not over.wait(0.01):
                sink.on_tick()

        server = threading.Thread(target=serve)
        server.start()

        def may(request: dict[str, Any]) -> bool:
            try:
                ask(where, request, DEADLINE_S if reads else REFUSED_S, **keys)
            except SetupError as error:
                return "no recording" in str(error)  # it was asked, and has none
            return True

        try:
            assert may({"op": "status"}) is reads
            assert may({"op": "stop_recording"}) is steers
        finally:
            over.set()
            server.join()


@pytest.mark.parametrize(
    ("name", "gets_in"), [("cam", True), ("ana", False), ("bob", False), ("eve", False), (None, False)]
)
def test_producers_need_a_key_that_may_send(folder: Path, name: str | None, gets_in: bool) -> None:
    source = ZmqSource(ZmqSettings(endpoint="tcp://127.0.0.1:0"), small_array())
    source.security = secured(folder)
    source.open()
    with zmq.Context() as context, context.socket(zmq.PUSH) as socket:
        socket.linger = 0
        if name:
            connect_with(socket, **key_of(folder, name))
        socket.connect(source.details()["endpoint"])
        socket.sndtimeo = int(REFUSED_S * 1e3)
        with suppress(zmq.Again):  # nobody takes it
            socket.send_multipart(encode_csi(some_block(3)))
        block = source.recv(DEADLINE_S if gets_in else REFUSED_S)
        assert (block is not None) is gets_in
    source.close()


def test_one_connection_too_many_is_turned_away_until_another_goes() -> None:
    sink = publisher()
    with running(sink, SecuritySettings(max_connections=2)) as where:
        first, second = subscribe(where), subscribe(where)
        for charts in (first, second):
            assert comes(sink.on_tick, lambda c=charts: c.recv(0.02), DEADLINE_S)  # type: ignore[misc]
        third = subscribe(where)
        assert not comes(sink.on_tick, lambda: third.recv(0.02), REFUSED_S)
        assert set(sink.refused.as_dict()) == {"too_many_connections"}
        first.close()
        third.close()
        with subscribe(where) as fourth:
            assert comes(sink.on_tick, lambda: fourth.recv(0.02), DEADLINE_S)
        second.close()


def test_whoever_subscribes_too_much_is_shown_the_door_and_nobody_else() -> None:
    sink = publisher()
    with running(sink, SecuritySettings(max_subscriptions=8)) as where, subscribe(where) as good:
        assert comes(sink.on_tick, lambda: good.recv(0.02), DEADLINE_S)
        with zmq.Context() as context, context.socket(zmq.SUB) as greedy:
            greedy.linger = 0
            greedy.connect(where)
            for n in range(1000):
                greedy.subscribe(f"chart.{n}")
            # ZeroMQ subscribes anew after a new connection when it is called.
            assert comes(sink.on_tick, lambda: greedy.poll(5) or sink.refused.total() >= 2, DEADLINE_S)
        assert set(sink.refused.as_dict()) == {"too_many_subscriptions"}
        sink.on_chart(some_chart(3))
        assert comes(sink.on_tick, lambda: good.recv(0.02), DEADLINE_S)
        assert good.restarts == 0


def test_ipv6(folder: Path) -> None:
    sink = publisher("tcp://[::1]:0")
    sink.security = secured(folder)
    try:
        sink.open(StillNode(some_chart(20, seed=4), QUALITY))
    except SetupError:
        pytest.skip("this machine has no IPv6")
    with subscribe(sink.where() or "", **key_of(folder, "ana")) as charts:
        assert comes(sink.on_tick, lambda: charts.recv(0.02), DEADLINE_S)
    sink.close()


@pytest.mark.parametrize(
    "endpoint", ["tcp://0.0.0.0:5556", "tcp://*:5556", "tcp://[::]:5556", "tcp://192.168.1.5:5556"]
)
def test_an_endpoint_that_others_reach_needs_keys(folder: Path, endpoint: str) -> None:
    parts = (
        PublisherSettings(endpoint=endpoint),
        ControlSettings(endpoint=endpoint),
        ZmqSettings(endpoint=endpoint),
    )
    for settings in parts:
        [mistake] = settings.exposure(SecuritySettings(trust_local=True))
        assert endpoint in mistake
        assert "set keys in [security]" in mistake
        assert settings.exposure(secured(folder)) == []
    for settings in parts[::2]:
        assert settings.exposure(SecuritySettings(without_keys=(endpoint,))) == []
    (folder / "node.key_secret").chmod(0o644)
    for settings in parts:
        [mistake] = settings.exposure(secured(folder))
        assert "chmod 600" in mistake


def test_keys_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["keys", "list"]) == EX_CONFIG
    assert main(["keys", "new", "node"]) == 0
    assert main(["keys", "new", "node"]) == EX_CONFIG
    assert "never overwritten" in capsys.readouterr().err
    assert main(["keys", "new", "ana"]) == 0
    assert main(["keys", "new", "../ana"]) == EX_CONFIG
    assert main(["keys", "allow", "ana.key", "--may", "read"]) == 0
    assert main(["keys", "allow", "nobody.key", "--may", "read"]) == EX_CONFIG
    capsys.readouterr()
    assert main(["keys", "list"]) == 0
    assert capsys.readouterr().out.split() == ["read", "ana", "steer", "-", "send", "-"]
    assert Path("ana.key_secret").stat().st_mode & 0o777 == 0o600
    assert Path("keys/node.key_secret").stat().st_mode & 0o777 == 0o600
    secret = KeyPair.load(Path("ana.key_secret"))
    assert secret.public == load_public(Path("ana.key"))
    assert secret.secret.decode() not in repr(secret)
    ring = KeyRing(Path("keys"), ("read",))
    assert ring.who(secret.public) == ("read", "ana")
    assert main(["keys", "new", "ana", "--folder", "new"]) == 0
    assert main(["keys", "allow", "new/ana.key", "--may", "read"]) == 0
    assert ring.who(secret.public) is None, "another key of the same name goes before"
    assert ring.who(load_public(Path("new/ana.key"))) == ("read", "ana")


@pytest.mark.parametrize(
    "text", ["", "public-key", 'public-key = "short"', "\0" * 100, 'public-key = "' + "é" * 40]
)
def test_what_is_no_key_lets_nobody_in(tmp_path: Path, text: str) -> None:
    (tmp_path / "read").mkdir()
    (tmp_path / "read" / "odd.key").write_text(text)
    assert KeyRing(tmp_path, ("read",)).who(b"x" * 40) is None
    with pytest.raises(SetupError):
        load_public(tmp_path / "read" / "odd.key")
