"""What the server does for people it does not know, and about requests that no browser would send."""

from __future__ import annotations

import http.client
import socket
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import pytest
from live_node import tool

from chachart.node.data.errors import SetupError
from chachart.node.net.limits import RateLimit
from chachart.node.net.security import SecuritySettings, Tokens
from chachart.sinks.web.answers import SECURITY, Answer, Query
from chachart.sinks.web.connection import LONGEST_BODY, WebConnection
from chachart.sinks.web.server import WebServer
from chachart.sinks.web.settings import WebSettings

TOKEN = "open-sesame-open-sesame"
READ = "only-look-only-look-only"
FORM = {"Content-Type": "application/x-www-form-urlencoded"}
HTML = {"Accept": "text/html"}


def page(query: Query) -> Answer:
    return Answer.text(200, repr(sorted(query.items())))


ROUTES = {"GET /": page, "GET /page": page, "POST /do": page}


def server(**settings: object) -> WebServer:
    security = {k: settings.pop(k) for k in list(settings) if k in SecuritySettings.model_fields}
    web = WebSettings.model_validate({"type": "web", "port": 0, **settings})
    made = WebServer(
        web, ROUTES, sign_in_page=b"<!-- reason -->", security=SecuritySettings.model_validate(security)
    )
    made.start()
    return made


@pytest.fixture
def guarded() -> Iterator[WebServer]:
    made = server(token=TOKEN, read_token=READ)
    yield made
    made.stop()


@pytest.fixture
def open_server() -> Iterator[WebServer]:
    made = server()
    yield made
    made.stop()


def ask(
    made: WebServer, method: str, target: str, headers: dict[str, str] | None = None, body: str | None = None
) -> tuple[int, dict[str, str], str]:
    connection = http.client.HTTPConnection("127.0.0.1", made.port, timeout=30)
    try:
        connection.request(method, target, body, headers or {})
        response = connection.getresponse()
        return response.status, dict(response.getheaders()), response.read().decode()
    finally:
        connection.close()


def raw(made: WebServer, data: bytes) -> bytes:
    """What comes back for these bytes."""
    with socket.create_connection(("127.0.0.1", made.port), 30) as client:
        client.sendall(data)
        received = b""
        while more := client.recv(65536):
            received += more
        return received


def sign_in(made: WebServer, token: str) -> tuple[int, dict[str, str], str]:
    return ask(made, "POST", "/login", FORM, urlencode({"token": token}))


@pytest.mark.parametrize(("token", "may_steer"), [(TOKEN, True), (READ, False)])
def test_signing_in_gives_a_cookie_that_is_not_the_token(
    guarded: WebServer, token: str, may_steer: bool
) -> None:
    status, headers, _ = sign_in(guarded, token)
    assert (status, headers["Location"]) == (303, "/")
    cookie = headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert token not in cookie
    kept = {"Cookie": cookie.split(";")[0]}
    assert ask(guarded, "GET", "/", kept)[0] == 200
    assert ask(guarded, "POST", "/do", kept)[0] == (200 if may_steer else 403)
    status, headers, _ = ask(guarded, "POST", "/logout", kept)
    assert (status, "Max-Age=0" in headers["Set-Cookie"]) == (303, True)


def test_who_looks_may_come_back_with_the_token_that_steers(guarded: WebServer) -> None:
    kept = {"Cookie": sign_in(guarded, READ)[1]["Set-Cookie"].split(";")[0]}
    assert ask(guarded, "POST", "/do", kept)[0] == 403
    assert ask(guarded, "POST", f"/do?token={TOKEN}", kept)[0] == 200
    assert ask(guarded, "GET", "/?token=something-that-is-wrong", kept)[0] == 200
    _, headers, _ = ask(guarded, "GET", f"/?token={TOKEN}", {**kept, **HTML})
    assert ask(guarded, "POST", "/do", {"Cookie": headers["Set-Cookie"].split(";")[0]})[0] == 200


def test_people_on_this_machine_need_the_token_too_once_it_is_set(guarded: WebServer) -> None:
    status, headers, text = ask(guarded, "GET", "/")
    assert (status, text) == (401, "a token is needed")
    assert headers["WWW-Authenticate"] == 'Bearer realm="chachart"'
    trusting = server(token=TOKEN, trust_local=True)
    assert ask(trusting, "GET", "/")[0] == 200
    assert ask(trusting, "GET", "/", {"X-Forwarded-For": "10.0.0.7"})[0] == 401
    assert ask(trusting, "GET", "/", {"Host": "evil.example"})[0] == 401
    trusting.stop()


def test_guessing_is_slow_and_disturbs_nobody_who_is_in(guarded: WebServer) -> None:
    kept = {"Cookie": sign_in(guarded, TOKEN)[1]["Set-Cookie"].split(";")[0]}
    statuses = [sign_in(guarded, f"guess number {n}")[0] for n in range(15)]
    assert statuses[:10] == [401] * 10
    assert statuses[10:] == [429] * 5
    assert sign_in(guarded, TOKEN)[0] == 429
    assert ask(guarded, "GET", "/", {"Authorization": f"Bearer {TOKEN}"})[0] == 429
    assert ask(guarded, "GET", "/", kept)[0] == 200
    assert guarded.refusals.as_dict() == {"wrong_token": 10, "too_many_guesses": 7}


def test_a_rate_comes_back_with_time() -> None:
    now = 0.0
    limit = RateLimit(0.5, 2, lambda: now)
    assert [limit.take("a") for _ in range(3)] == [True, True, False]
    assert limit.take("b")
    assert limit.wait_s("a") == 2.0
    now = 2.0
    assert [limit.take("a") for _ in range(2)] == [True, False]


@pytest.mark.parametrize(
    "path", ["/\\evil.example", "//evil.example", "/%5Cevil.example", "/%0d%0aX:y", "http://evil.example/"]
)
def test_no_token_sends_a_browser_elsewhere(guarded: WebServer, path: str) -> None:
    answer = raw(
        guarded, f"GET {path}?token={TOKEN} HTTP/1.1\r\nHost: x\r\nAccept: text/html\r\n\r\n".encode()
    )
    assert b"evil" not in answer
    assert b"Location: /\r\n" in answer


def test_a_token_leaves_the_address_bar(guarded: WebServer) -> None:
    status, headers, _ = ask(guarded, "GET", f"/page?a=1&token={TOKEN}", HTML)
    assert (status, headers["Location"]) == (303, "/page?a=1")


def test_bodies_are_read_or_refused_with_an_answer(open_server: WebServer) -> None:
    assert ask(open_server, "POST", "/do?a=1", FORM, "b=2")[::2] == (200, "[('a', '1')]\n")
    assert ask(open_server, "POST", "/do", FORM, "b" * LONGEST_BODY)[0] == 200
    start = b"POST /do HTTP/1.1\r\nHost: localhost\r\n"
    for header, status in (
        (b"Content-Length: 16385", 413),
        (b"Content-Length: 99999999999999999999", 400),
        (b"Content-Length: -1", 400),
        (b"Content-Length: 1\r\nContent-Length: 2", 411),
        (b"Transfer-Encoding: chunked", 411),
        (b"Content-Length: 3\r\nTransfer-Encoding: chunked", 411),
    ):
        answer = raw(open_server, start + header + b"\r\n\r\nabc")
        assert answer.startswith(f"HTTP/1.1 {status} ".encode()), (header, answer)


def test_half_a_body_and_a_long_head_end(open_server: WebServer) -> None:
    head = b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 100_000
    assert b" 200 " not in raw(open_server, head)[:20]
    with socket.create_connection(("127.0.0.1", open_server.port), 30) as client:
        client.sendall(b"POST /do HTTP/1.1\r\nHost: localhost\r\nContent-Length: 10\r\n\r\nabc")
        assert ask(open_server, "GET", "/")[0] == 200


@pytest.mark.parametrize("target", ["/", "/nothing", "/do"])
def test_head_has_headers_and_no_body(open_server: WebServer, target: str) -> None:
    answer = raw(open_server, f"HEAD {target} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    head, _, body = answer.partition(b"\r\n\r\n")
    assert body == b""
    get = raw(open_server, f"GET {target} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    length = next(line for line in head.split(b"\r\n") if line.startswith(b"Content-Length"))
    assert length in get


def test_headers_that_keep_pages_apart(open_server: WebServer) -> None:
    headers = ask(open_server, "GET", "/")[1]
    assert "unsafe-inline" not in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    for policy in ("Opener", "Resource"):
        assert headers[f"Cross-Origin-{policy}-Policy"] == "same-origin"


GET = b"GET / HTTP/1.1\r\nHost: localhost\r\n"
UPGRADE = GET.replace(b"/ ", b"/ws ", 1) + b"Upgrade: websocket\r\nConnection: Upgrade\r\n"


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"GARBAGE\r\n\r\n", 400),
        (b"get / HTTP/1.1\r\n\r\n", 400),
        (b"GET / HTTP/2.0\r\n\r\n", 400),
        (b"GET /\xff HTTP/1.1\r\n\r\n", 400),
        (GET + b"no colon\r\n\r\n", 400),
        (GET + b"X: \0\r\n\r\n", 400),
        (GET + b"X: " + b"y" * 9000 + b"\r\n\r\n", 431),
        (GET + b"X: y\r\n" * 200 + b"\r\n", 431),
        (GET + b"X: y\r\n" * 20_000, 431),
        (GET.replace(b"GET", b"BREW") + b"\r\n", 405),
        (GET.replace(b"/ ", b"/../../etc/passwd ") + b"\r\n", 404),
        (UPGRADE + b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: x\r\n\r\n", 400),
        (GET.replace(b"/ ", b"/ws ") + b"\r\n", 426),
    ],
)
def test_whatever_is_sent_has_an_answer_with_every_header(data: bytes, status: int) -> None:
    async def leave(viewer: WebConnection) -> None:
        await viewer.close()

    made = WebServer(WebSettings.model_validate({"type": "web", "port": 0}), ROUTES, leave)
    made.start()
    head, _, body = raw(made, data).partition(b"\r\n\r\n")
    made.stop()
    assert head.startswith(f"HTTP/1.1 {status} ".encode()), head
    assert body
    for name in SECURITY:
        assert f"\r\n{name}: ".encode() in head, name


@pytest.mark.parametrize("origin", ["http://[", "null", "x", "http://evil.example"])
def test_odd_origins_are_turned_away_in_order(open_server: WebServer, origin: str) -> None:
    assert ask(open_server, "GET", "/", {"Origin": origin})[0] == 403


def test_too_many_requests_and_connections_are_turned_away() -> None:
    made = server(max_requests_per_s=1.0)
    statuses = [ask(made, "GET", "/")[0] for _ in range(8)]
    assert statuses[:5] == [200] * 5
    assert statuses.count(429) >= 2
    made.stop()
    made = server(max_connections=3)
    held = [socket.create_connection(("127.0.0.1", made.port), 30) for _ in range(3)]
    assert raw(made, b"").startswith(b"HTTP/1.1 503 ")
    assert made.refusals.as_dict() == {"too_many_connections": 1}
    for client in held:
        client.close()
    assert raw(made, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
    made.stop()


def test_ipv6_is_served_and_named_in_brackets() -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")
    made = server(host="::1")
    assert made.address == f"http://[::1]:{made.port}"
    connection = http.client.HTTPConnection("::1", made.port, timeout=30)
    connection.request("GET", "/")
    assert connection.getresponse().status == 200
    connection.close()
    made.stop()


@pytest.fixture
def certificate(tmp_path: Path) -> dict[str, Path]:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    made = subprocess.run(
        [
            *(tool("openssl", "openssl"), "req", "-x509", "-nodes", "-days", "2", "-subj", "/CN=localhost"),
            *("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"),
            *("-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"),
            *("-keyout", str(key), "-out", str(cert)),
        ],
        capture_output=True,
    )
    assert made.returncode == 0, made.stderr
    return {"tls_cert": cert, "tls_key": key}


def test_https(certificate: dict[str, Path]) -> None:
    made = server(token=TOKEN, **certificate)
    assert made.address.startswith("https://")
    context = ssl.create_default_context(cafile=str(certificate["tls_cert"]))
    connection = http.client.HTTPSConnection("127.0.0.1", made.port, timeout=30, context=context)
    connection.request("POST", "/login", urlencode({"token": TOKEN}), FORM)
    response = connection.getresponse()
    assert response.status == 303
    assert "; Secure" in response.headers["Set-Cookie"]
    connection.close()
    with pytest.raises((http.client.HTTPException, OSError)):
        ask(made, "GET", "/")
    made.stop()


def test_a_certificate_that_cannot_be_read_is_a_mistake(certificate: dict[str, Path], tmp_path: Path) -> None:
    settings = WebSettings.model_validate({"type": "view", "port": 0})
    assert settings.exposure(SecuritySettings(**certificate)) == []
    [mistake] = settings.exposure(SecuritySettings(tls_cert=certificate["tls_cert"]))
    assert "go together" in mistake
    swapped = SecuritySettings(tls_cert=certificate["tls_key"], tls_key=certificate["tls_cert"])
    [mistake] = settings.exposure(swapped)
    assert "cannot serve HTTPS" in mistake
    [mistake] = settings.exposure(SecuritySettings(tls_cert=tmp_path / "no", tls_key=tmp_path / "no"))
    assert "No such file" in mistake


def test_a_token_in_a_file_is_its_owners_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    file.chmod(0o640)
    with pytest.raises(SetupError, match="chmod 600"):
        Tokens.of(SecuritySettings(token_file=file))
    file.chmod(0o600)
    assert Tokens.of(SecuritySettings(token_file=file)) == Tokens(TOKEN)
    with pytest.raises(SetupError, match="given twice"):
        Tokens.of(SecuritySettings(token_file=file, token=TOKEN))
    with pytest.raises(SetupError, match="must not be the steering token"):
        Tokens.of(SecuritySettings(token_file=file, read_token=TOKEN))
    file.write_text("short")
    with pytest.raises(SetupError, match="16 characters"):
        Tokens.of(SecuritySettings(token_file=file))
    with pytest.raises(SetupError, match="No such file"):
        Tokens.of(SecuritySettings(token_file=tmp_path / "no"))
    monkeypatch.setenv("CHACHART_TOKEN", TOKEN)
    monkeypatch.setenv("CHACHART_READ_TOKEN", READ)
    assert Tokens.of(SecuritySettings()) == Tokens(TOKEN, READ)
