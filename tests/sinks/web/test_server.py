"""The server alone, with routes of its own."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

from chachart.node.data.errors import RequestError, SetupError
from chachart.sinks.metrics import Metrics, MetricsSettings
from chachart.sinks.web.answers import Answer, Query, Route
from chachart.sinks.web.server import THREADS, WAITING_LIMIT, WebServer
from chachart.sinks.web.settings import WebSettings, port_problems

TOKEN = "open-sesame-open-sesame"


def echo(query: Query) -> Answer:
    return Answer.text(200, repr(sorted(query.items())))


def refuse(_: Query) -> Answer:
    raise RequestError("not today")


def fail(_: Query) -> Answer:
    raise ZeroDivisionError


@dataclass
class Response:
    status: int
    headers: Mapping[str, str]
    text: str


@contextmanager
def serving(routes: Mapping[str, Route], **settings: object) -> Iterator[Callable[..., Response]]:
    server = WebServer(WebSettings.model_validate({"type": "web", "port": 0, **settings}), routes)
    server.start()

    def get(target: str, method: str = "GET", **headers: str) -> Response:
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
        try:
            connection.request(method, target, headers={k.replace("_", "-"): v for k, v in headers.items()})
            response = connection.getresponse()
            return Response(response.status, dict(response.getheaders()), response.read().decode())
        finally:
            connection.close()

    try:
        yield get
    finally:
        server.stop()


def test_a_spare_port_serves_where_the_port_is_taken() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        settings = WebSettings.model_validate({"type": "web", "port": port, "spare_ports": 50})
        assert port_problems(settings) == []
        server = WebServer(settings, {})
        server.start()
        assert port < server.port <= port + 50
        server.stop()
        assert port_problems(settings.model_copy(update={"spare_ports": 0}))


def test_routes_by_method_and_path() -> None:
    with serving({"GET /echo": echo, "POST /echo": echo, "GET /no": refuse, "GET /fail": fail}) as get:
        answer = get("/echo?b=2&a=%C3%A9%26")
        assert (answer.status, answer.text) == (200, "[('a', 'é&'), ('b', '2')]\n")
        assert get("/echo", "POST").status == 200
        assert get("/echo", "HEAD").text == ""
        missing = get("/echo", "DELETE")
        assert (missing.status, missing.headers["Allow"]) == (405, "GET, POST")
        assert get("/elsewhere").status == 404
        assert get("/../../etc/passwd").status == 404
        refused = get("/no")
        assert (refused.status, refused.text) == (400, '{"error": "not today"}')
        assert get("/fail").status == 500
        assert get("/echo").headers["Content-Security-Policy"].startswith("default-src 'none'")


def test_too_many_at_once_are_told_so() -> None:
    """Requests that hold every thread, then as many as may wait, then one too many."""
    go = threading.Event()

    def hold(_: Query) -> Answer:
        go.wait(30)
        return Answer.text(200, "at last")

    with serving({"GET /hold": hold}) as get:
        statuses: list[int] = []
        threads = [
            threading.Thread(target=lambda: statuses.append(get("/hold").status))
            for _ in range(WAITING_LIMIT + THREADS)
        ]
        for thread in threads:
            thread.start()
        while len(statuses) < THREADS:
            threads[0].join(0.02)
        go.set()
        for thread in threads:
            thread.join()
        assert statuses.count(400) == THREADS
        assert statuses.count(200) == WAITING_LIMIT


def test_a_port_in_use_is_told_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        settings = MetricsSettings(port=taken.getsockname()[1])
        expected = f'sink "metrics" cannot listen on 127.0.0.1:{settings.port}: Address already in use'
        assert Metrics.problems(settings) == [expected]
        with pytest.raises(SetupError, match="Address already in use"):
            WebServer(settings, {}).start()
    assert Metrics.problems(settings) == []


def test_an_address_of_another_machine_is_told() -> None:
    settings = MetricsSettings(host="192.0.2.1", token=TOKEN)
    assert "Cannot assign requested address" in Metrics.problems(settings)[0]
    with pytest.raises(SetupError, match="Cannot assign requested address"):
        WebServer(settings, {}).start()


def test_a_host_that_cannot_be_a_name_is_told_in_one_line() -> None:
    [problem] = port_problems(WebSettings(type="metrics", host="a..b", token="x" * 16))
    assert "a..b" in problem
