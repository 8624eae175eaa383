"""Every operation, asked by everybody over every channel: who gets in, exactly.

Keys are in test_who_gets_in_with_keys.py: there is no other way into a socket that needs them.
"""

from __future__ import annotations

import asyncio
import http.client
import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import zmq
from chart_samples import QUALITY, StillNode, some_chart
from csi_samples import small_array
from live_node import other_address
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from chachart.node.data.errors import RequestError
from chachart.node.net.security import SecuritySettings
from chachart.sinks.base import Sink
from chachart.sinks.control import Control, ControlSettings
from chachart.sinks.operations import CHANGING, READING
from chachart.sinks.view.sink import View, ViewSettings

STEER, READ = "steer-steer-steer-steer", "read-read-read-read"
PAGES = ("/", "/main.js", "/healthz", "/readyz", "/metrics", "/recordings?name=no.mcap")
ARGUMENTS: dict[str, dict[str, Any]] = {
    "spectrum": {"ue": 1},
    "set_method": {"theta": "music", "rho": "music"},
    "method": {"theta": "music", "rho": "music"},
    "replay": {"speed": 1},
    "start_recording": {"path": "a.mcap"},
    "record": {"on": "false"},
}


class PatientNode(StillNode):
    """Answers everything, and carries nothing out: whoever is let in gets an answer of its own."""

    def __getattr__(self, name: str) -> Any:
        def answer(*_: Any, **__: Any) -> dict[str, Any]:
            raise RequestError("you are in")

        return answer


@dataclass(frozen=True)
class Who:
    """Somebody: what they say, and where they are. `remote` people come from this machine's other address."""

    headers: Mapping[str, str] = field(default_factory=dict)
    token: str | None = None
    remote: bool = False


WRONG = "wrong-wrong-wrong-wrong"
PEOPLE = {
    "local": Who(),
    "local, wrong token": Who(token=WRONG),
    "local, reading token": Who(token=READ),
    "local, token": Who(token=STEER),
    "proxied": Who({"X-Forwarded-For": "10.0.0.7"}),
    "proxied by another header": Who({"Forwarded": "for=10.0.0.7"}),
    "proxied, wrong token": Who({"X-Forwarded-For": "10.0.0.7"}, WRONG),
    "proxied, reading token": Who({"X-Forwarded-For": "10.0.0.7"}, READ),
    "proxied, token": Who({"X-Real-IP": "10.0.0.7"}, STEER),
    "foreign host": Who({"Host": "evil.example"}),
    "foreign host, token": Who({"Host": "node.lab"}, STEER),
    "foreign page": Who({"Origin": "http://evil.example"}),
    "foreign page, token": Who({"Origin": "http://evil.example"}, STEER),
    "remote": Who(remote=True),
    "remote, wrong token": Who(token=WRONG, remote=True),
    "remote, reading token": Who(token=READ, remote=True),
    "remote, token": Who(token=STEER, remote=True),
}
NOTHING, LOOKS, STEERS = 0, 1, 2
TABLE = {
    "no token set": {
        **dict.fromkeys(PEOPLE, NOTHING),
        **dict.fromkeys(("local", "local, wrong token", "local, reading token", "local, token"), STEERS),
    },
    "tokens": {
        **dict.fromkeys(PEOPLE, NOTHING),
        **{who: LOOKS for who in PEOPLE if who.endswith("reading token")},
        **{who: STEERS for who in PEOPLE if who.endswith(", token") and not who.startswith("foreign page")},
    },
}
TABLE["tokens, local people trusted"] = {**TABLE["tokens"], "local": STEERS}
SETTINGS = {
    "no token set": SecuritySettings(),
    "tokens": SecuritySettings(token=STEER, read_token=READ),
    "tokens, local people trusted": SecuritySettings(token=STEER, read_token=READ, trust_local=True),
}
CASES = [(rules, who) for rules in TABLE for who in PEOPLE]


def opened(sink: Sink, rules: str) -> Sink:
    sink.security = SETTINGS[rules]
    sink.open(PatientNode(some_chart(), QUALITY))
    return sink


@contextmanager
def serving(rules: str, folder: Path) -> Iterator[View]:
    """A view that all of the machine's addresses reach; one for each test, as wrong tokens are remembered."""
    view = View(ViewSettings(host="0.0.0.0", port=0, record_folder=folder), small_array())
    opened(view, rules)
    try:
        yield view
    finally:
        view.close()


def address_of(view: View, who: Who) -> tuple[str, int]:
    host = other_address() if who.remote else "127.0.0.1"
    if host is None:
        pytest.skip("this machine has no address but loopback")
    return host, int((view.where() or "").rstrip("/").rpartition(":")[2])


def headers_of(who: Who, host: str, port: int) -> dict[str, str]:
    bearer = {} if who.token is None else {"Authorization": f"Bearer {who.token}"}
    return {"Host": f"{host}:{port}", **bearer, **who.headers}


def status(view: View, who: Who, method: str, target: str) -> int:
    host, port = address_of(view, who)
    connection = http.client.HTTPConnection(host, port, timeout=30)
    try:
        connection.putrequest(method, target, skip_host=True)
        for name, value in headers_of(who, host, port).items():
            connection.putheader(name, value)
        connection.endheaders()
        return connection.getresponse().status
    finally:
        connection.close()


def let_in(code: int) -> bool:
    assert code in (200, 400, 401, 403, 429, 503), code
    return code in (200, 400, 503)


@pytest.mark.parametrize(("rules", "who"), CASES)
def test_pages_and_http(tmp_path: Path, rules: str, who: str) -> None:
    may = TABLE[rules][who]
    with serving(rules, tmp_path) as view:
        for path in PAGES:
            assert let_in(status(view, PEOPLE[who], "GET", path)) is (may >= LOOKS), path
        for method, operations, least in (("GET", READING, LOOKS), ("POST", CHANGING, STEERS)):
            for op in operations:
                query = "&".join(f"{k}={v}" for k, v in ARGUMENTS.get(op, {}).items())
                code = status(view, PEOPLE[who], method, f"/api/{op}?{query}")
                assert let_in(code) is (may >= least), (op, code)


async def answers(view: View, who: Who) -> dict[str, bool] | int:
    """For each operation over the WebSocket whether it is allowed; the HTTP status of who is turned away."""
    host, port = address_of(view, who)
    told = headers_of(who, host, port)
    origin, named = told.pop("Origin", None), told.pop("Host")
    url = f"ws://{named if ':' in named else f'{named}:{port}'}/ws"
    got: dict[str, bool] = {}
    places: dict[str, Any] = {"origin": origin, "host": host, "port": port}
    try:
        async with connect(url, additional_headers=told, **places) as viewer:
            for op in (*READING, *CHANGING):
                if op in ("ues", "chart"):  # one of them would have to wait for the other
                    continue
                arguments = {**ARGUMENTS.get(op, {}), **({"on": False} if op == "record" else {})}
                await viewer.send(json.dumps({"id": op, "op": op, **arguments}))
                while True:
                    message = await viewer.recv()
                    if isinstance(message, str) and (answer := json.loads(message)).get("id") == op:
                        break
                got[op] = "may only read" not in answer.get("error", "")
    except InvalidStatus as error:
        return error.response.status_code
    return got


@pytest.mark.parametrize(("rules", "who"), CASES)
def test_the_websocket(tmp_path: Path, rules: str, who: str) -> None:
    may = TABLE[rules][who]
    with serving(rules, tmp_path) as view:
        got = asyncio.run(answers(view, PEOPLE[who]))
    if isinstance(got, int):
        assert got in (401, 403)
        assert may == NOTHING
    else:
        assert may >= LOOKS
        for op, allowed in got.items():
            assert allowed is (op in READING or may == STEERS), op


@pytest.mark.parametrize("rules", TABLE)
@pytest.mark.parametrize("token", [None, WRONG, READ, STEER])
def test_control(rules: str, token: str | None) -> None:
    name = (
        "local" if token is None else {WRONG: "local, wrong token", READ: "local, reading token"}.get(token)
    )
    may = TABLE[rules][name or "local, token"]
    sink = opened(Control(ControlSettings(endpoint="tcp://127.0.0.1:0"), small_array()), rules)
    over = threading.Event()

    def serve() -> None:
        while not over.wait(0.002):
            sink.on_tick()

    server = threading.Thread(target=serve)
    server.start()
    try:
        with zmq.Context() as context, context.socket(zmq.REQ) as asker:
            asker.linger, asker.rcvtimeo = 0, 20_000
            asker.connect(sink.where() or "")
            for op in (*READING, *CHANGING):
                given = {} if token is None else {"token": token}
                asker.send(json.dumps({"op": op, **given, **ARGUMENTS.get(op, {})}).encode())
                reply = json.loads(asker.recv())
                refused = ("may only read", "a token is needed", "not the token", "wrong tokens")
                allowed = reply["ok"] or not any(word in reply["error"] for word in refused)
                assert allowed is (may >= (LOOKS if op in READING else STEERS)), (op, reply)
    finally:
        over.set()
        server.join()
        sink.close()


def test_no_secret_is_in_status_or_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with serving("tokens", tmp_path) as view:
        for who in PEOPLE.values():
            if not who.remote:
                status(view, who, "GET", f"/api/status?token={who.token}")
    told = json.dumps(view.refused.as_dict()) + caplog.text + repr(view.settings) + repr(view.security)
    for secret in (STEER, READ, WRONG):
        assert secret not in told
