"""Control over ZeroMQ, and `chachart ctl` on top of it, with a real node."""

from __future__ import annotations

import csv
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st
from live_node import LiveNode, until

from chachart.node.commands.main import main
from chachart.node.data.errors import EX_CONFIG, RequestError
from chachart.sinks.control import decode_request

JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text() | st.integers(0, 9), inner, max_size=3)
    ),
    max_leaves=5,
)


def ctl(node: LiveNode, *arguments: str) -> int:
    return main(["ctl", "--endpoint", node.address("control"), *arguments])


def exchange(node: LiveNode, *messages: bytes) -> list[bytes]:
    """Replies to raw requests, one socket for all."""
    with zmq.Context() as context, context.socket(zmq.REQ) as socket:
        socket.linger = 0
        socket.rcvtimeo = 30_000
        socket.connect(node.address("control"))
        replies = []
        for message in messages:
            socket.send(message)
            replies.append(socket.recv())
        return replies


def test_json_is_answered_in_json_and_msgpack_in_msgpack(node: LiveNode) -> None:
    until(lambda: node.ask("api/status")["ues"] == 60, "all UEs are there")
    request = {"op": "spectrum", "ue": 7}
    json_reply, msgpack_reply = exchange(node, json.dumps(request).encode(), msgpack.packb(request))
    for reply in (json.loads(json_reply), msgpack.unpackb(msgpack_reply)):
        assert reply["ok"] is True
        assert len(reply["result"]["theta_grid_rad"]) > 50


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"{",
        b"\xc1",
        b'{"op": "fly"}',
        b'{"op": "method", "theta": "music"}',
        b'{"op": "record", "on": true, "path": "../x.mcap"}',
        b'{"op": "status", "token": "\\ud800"}1',
        msgpack.packb([1, 2]),
        msgpack.packb({1: 2}),
        msgpack.packb({"op": "spectrum", "ue": 2**64 - 1}),
        b"[" * 10_000,
    ],
)
def test_bad_requests_get_an_error_and_the_next_good_one_its_answer(node: LiveNode, message: bytes) -> None:
    before = node.ask("api/status")
    bad, good = exchange(node, message, b'{"op": "status"}')
    reply: dict[str, Any] = json.loads(bad) if message[:1] == b"{" else msgpack.unpackb(bad)
    assert reply["ok"] is False
    assert reply["error"]
    after = json.loads(good)["result"]
    assert (after["method"], after["recording"]) == (before["method"], before["recording"])


@given(st.binary(max_size=200) | JSON.map(json.dumps).map(str.encode) | JSON.map(msgpack.packb))
def test_whatever_comes_is_a_map_or_an_error(message: bytes) -> None:
    with suppress(RequestError):
        assert all(isinstance(key, str) for key in decode_request([zmq.Frame(message)]))


def test_ctl_shows_the_node(node: LiveNode, capsys: pytest.CaptureFixture[str]) -> None:
    until(lambda: (node.ask("api/status")["quality"] or {}).get("tw"), "there is a quality report")
    assert ctl(node, "status") == 0
    assert "running" in capsys.readouterr().out
    assert ctl(node, "status", "--json") == 0
    assert json.loads(capsys.readouterr().out)["ues"] == 60
    assert ctl(node, "ues") == 0
    assert len(capsys.readouterr().out.splitlines()) == 61
    assert ctl(node, "spectrum", "7") == 0
    assert "degrees" in capsys.readouterr().out


def test_ctl_changes_the_method_and_no_frame_is_lost(node: LiveNode) -> None:
    assert ctl(node, "method", "music", "bartlett") == 0
    until(lambda: node.ask("api/chart")["method"]["theta"] == "music", "the chart is made with MUSIC")
    assert ctl(node, "method", "bartlett", "bartlett") == 0
    until(lambda: node.ask("api/chart")["method"]["theta"] == "bartlett", "and with Bartlett again")
    status = node.ask("api/status")
    assert set(status["dropped"]) <= {"queue_full"}, "a slow machine may drop, a change may not"
    assert sum(worker["restarts"] for worker in status["workers"]) == 0


def test_ctl_records(node: LiveNode, capsys: pytest.CaptureFixture[str]) -> None:
    assert ctl(node, "record", "start", "ctl.mcap") == 0
    assert "ctl.mcap" in capsys.readouterr().out
    assert ctl(node, "record", "stop") == 0
    assert (node.folder / "ctl.mcap").stat().st_size > 0
    assert ctl(node, "record", "stop") == EX_CONFIG
    assert "no recording" in capsys.readouterr().err


def test_ctl_saves_the_chart(node: LiveNode, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    until(lambda: node.ask("api/status")["ues"] == 60, "all UEs are there")
    assert ctl(node, "snapshot", str(tmp_path / "chart.csv")) == 0
    with (tmp_path / "chart.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sorted(int(row["ue"]) for row in rows) == list(range(60))
    assert all(float(row["x_m"]) >= 0 for row in rows)
    assert all(abs(float(row["true_x_m"]) - float(row["position_x_m"])) < 1 for row in rows)
    assert ctl(node, "snapshot", str(tmp_path / "chart.json")) == 0
    assert len(json.loads((tmp_path / "chart.json").read_text())["ue"]) == 60
    assert ctl(node, "snapshot", str(tmp_path / "chart.xlsx")) == EX_CONFIG
    assert ctl(node, "snapshot", str(tmp_path / "nowhere" / "chart.csv")) == EX_CONFIG
    assert "cannot be written" in capsys.readouterr().err


def test_ctl_says_when_no_node_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = f"ipc://{tmp_path}/nobody"
    assert main(["ctl", "--endpoint", endpoint, "--timeout", "0.2", "status"]) == EX_CONFIG
    assert "no node answers" in capsys.readouterr().err
    assert main(["ctl", "--endpoint", "nonsense", "status"]) == EX_CONFIG
    assert "no ZeroMQ endpoint" in capsys.readouterr().err
