"""The server: plain requests by routes, WebSocket connections by one handler, all on one port.

The `websockets` library reads requests without a body only, so arguments travel in the query string, for POST
as well; each plain request closes its connection. What may take long runs in a few threads of its own.
"""

from __future__ import annotations

import asyncio
import http
import json
import logging
import os
import socket as socketlib
import threading
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self, TypeVar
from urllib.parse import parse_qsl, quote, urlencode, urlsplit

from pydantic import Field, model_validator
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

from chachart.node.data.errors import RequestError, SetupError
from chachart.node.net.endpoints import fixed
from chachart.sinks.base import SinkSettings
from chachart.sinks.web.access import COOKIE, Access, is_loopback

THREADS = 4
WAITING_LIMIT = 64
CLOSE_WITHIN_S = 2.0
MAX_MESSAGE_BYTES = 16 * 1024
JSON = "application/json"
HTML = "text/html; charset=utf-8"

Query = Mapping[str, str]
T = TypeVar("T")

log = logging.getLogger(__name__)
_connections = logging.getLogger(f"{__name__}.connections")
_connections.setLevel(logging.WARNING)
_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
_SECURITY = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}


class WebSettings(SinkSettings):
    """What every sink that serves HTTP is told."""

    host: str = Field("127.0.0.1", min_length=1)
    """Address to listen on; anything but loopback needs a token."""
    port: int = Field(8080, ge=0, le=65535)
    """TCP port; 0 takes a free one."""
    spare_ports: int = Field(0, ge=0, le=1000)
    """Where the port is in use, one of so many after it serves instead; the log says which."""
    token: str | None = Field(None, min_length=16, repr=False)
    """What everybody must know who does not ask from this machine: 16 characters or more."""
    stale_after_s: float = Field(5.0, gt=0)
    """Without a new frame for so long, /readyz says no."""

    @model_validator(mode="after")
    def _closed_to_strangers(self) -> Self:
        if self.token is None and not is_loopback(self.host):
            raise ValueError(f"token must be set to listen on {self.host}, which others can reach")
        return self

    def listens_on(self) -> str | None:
        """Host and port, unless any free port will do."""
        return fixed(f"tcp://{self.host}:{self.port}")


def port_problems(settings: WebSettings) -> list[str]:
    """What would keep a server from listening where `settings` say."""
    problems: list[str] = []
    for port in _ports(settings):
        try:
            family, kind, proto, _, address = socketlib.getaddrinfo(
                settings.host, port, type=socketlib.SOCK_STREAM, flags=socketlib.AI_PASSIVE
            )[0]
            with socketlib.socket(family, kind, proto) as probe:
                probe.setsockopt(socketlib.SOL_SOCKET, socketlib.SO_REUSEADDR, 1)
                probe.bind(address)
        except OSError as error:
            problems = problems or [_cannot_listen(settings, error)]
        else:
            return []
    return problems


def _ports(settings: WebSettings) -> range:
    """The port and its spare ones, in the order in which they are tried."""
    return range(settings.port, min(settings.port + settings.spare_ports, 65535) + 1)


def _cannot_listen(settings: WebSettings, error: OSError) -> str:
    reason = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
    return f'sink "{settings.type}" cannot listen on {settings.host}:{settings.port}: {reason}'


@dataclass(frozen=True, slots=True)
class Answer:
    """What a route gives back."""

    body: bytes
    content_type: str
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def text(cls, status: int, text: str) -> Answer:
        """One line of plain text."""
        return cls(f"{text}\n".encode(), "text/plain; charset=utf-8", status)


Route = Callable[[Query], Answer]
"""Answers one request, in a thread of the server's."""
Handler = Callable[[ServerConnection], Awaitable[None]]


class WebServer:
    """Serves until it is stopped.

    Parameters
    ----------
    settings
        Where, and for whom.
    routes
        By `"METHOD /path"`.
    socket
        Handles WebSocket connections to `/ws`; None if there are none.
    beside
        Runs in the server's loop for as long as it serves.
    door
        HTML page for people who need a token; plain text where there is none.
    """

    def __init__(
        self,
        settings: WebSettings,
        routes: Mapping[str, Route],
        socket: Handler | None = None,
        beside: Callable[[], Coroutine[Any, Any, None]] | None = None,
        door: bytes | None = None,
    ) -> None:
        self._settings = settings
        self._routes = routes
        self._socket = socket
        self._beside = beside
        self._door = door
        self._access = Access(settings.token)
        self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="web")
        self._waiting = 0
        self._thread = threading.Thread(target=self._run, name="web", daemon=True)
        self._bound = threading.Event()
        self._failure: OSError | None = None
        self._stopping: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self.port = settings.port

    def start(self) -> None:
        """Bind the port and serve from now on.

        Raises
        ------
        SetupError
            If the address cannot be had.
        """
        self._thread.start()
        self._bound.wait()
        if self._failure is not None:
            self.stop()
            raise SetupError(_cannot_listen(self._settings, self._failure))

    def stop(self) -> None:
        """Close every connection and the port."""
        if self._stopping is not None:
            self.soon(self._stopping.set)
        self._thread.join(2 * CLOSE_WITHIN_S)
        self._pool.shutdown(wait=False, cancel_futures=True)

    @property
    def address(self) -> str:
        """Where a browser finds the server."""
        host = self._settings.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}"

    def soon(self, work: Callable[..., None], *arguments: Any) -> None:
        """Have that done in the server's thread, unless it has ended."""
        if self._thread.is_alive() and self._loop is not None:
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(work, *arguments)

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def call(self, work: Callable[[], T]) -> T:
        """Run what may block in a thread; at most `WAITING_LIMIT` wait for one.

        Raises
        ------
        RequestError
            If too many wait already.
        """
        if self._waiting >= WAITING_LIMIT:
            raise RequestError("too many requests wait already")
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._pool, work)
        finally:
            self._waiting -= 1

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._stopping = asyncio.Event()
        try:
            server = await self._listen()
        except OSError as error:
            self._failure = error
            return
        else:
            self.port = next(iter(server.sockets)).getsockname()[1]
        finally:
            self._bound.set()
        beside = None if self._beside is None else asyncio.create_task(self._beside())
        if beside is not None:
            beside.add_done_callback(_complain)
        await self._stopping.wait()
        if beside is not None:
            beside.cancel()
        server.close()
        await server.wait_closed()

    async def _listen(self) -> Server:
        """On the first port that can be had."""
        failure = OSError("there is no port")
        for port in _ports(self._settings):
            try:
                return await serve(
                    self._handle,
                    self._settings.host,
                    port,
                    process_request=self._process,
                    compression=None,
                    max_size=MAX_MESSAGE_BYTES,
                    max_queue=4,
                    server_header=None,
                    close_timeout=CLOSE_WITHIN_S / 2,
                    logger=_connections,
                )
            except OSError as error:
                failure = failure if failure.errno else error
        raise failure

    async def _handle(self, connection: ServerConnection) -> None:
        if self._socket is not None:
            await self._socket(connection)

    async def _process(self, connection: ServerConnection, request: Request) -> Response | None:
        url = urlsplit(request.path)
        query = dict(parse_qsl(url.query, max_num_fields=32))
        given = query.pop("token", None)
        peer = str(connection.remote_address[0])
        try:
            refusal = self._access.refusal(peer, request.headers, given)
        except MultipleValuesError as error:
            refusal = 400, f"the header {error} occurs twice"
        if refusal is not None:
            return _response(self._turn_away(*refusal))
        if url.path == "/ws" and self._socket is not None:
            return None
        if given is not None and "text/html" in ",".join(request.headers.get_all("Accept")):
            return _response(_remember(given, url.path, query))
        method = "GET" if request.method == "HEAD" else request.method
        response = _response(await self._answer(method, url.path, query))
        if request.method == "HEAD":
            response.body = b""
        return response

    async def _answer(self, method: str, path: str, query: Query) -> Answer:
        route = self._routes.get(f"{method} {path}")
        if route is None:
            allowed = [name.split()[0] for name in self._routes if name.split()[1] == path]
            if allowed:
                answer = Answer.text(405, f"{path} takes {', '.join(allowed)}")
                return replace(answer, headers={"Allow": ", ".join(allowed)})
            return Answer.text(404, f"there is no {path[:100]}")
        try:
            return await self.call(partial(route, query))
        except RequestError as error:
            return Answer(json.dumps({"error": str(error)}).encode(), JSON, 400)

    def _turn_away(self, status: int, reason: str) -> Answer:
        if status == 401:
            challenge = {"WWW-Authenticate": 'Bearer realm="chachart"'}
            if self._door is not None:
                return Answer(self._door, HTML, status, challenge)
            return replace(Answer.text(status, reason), headers=challenge)
        return Answer.text(status, reason)


def _complain(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        log.error("the web server's own work failed: %s", error, exc_info=error)


def _remember(token: str, path: str, query: Query) -> Answer:
    """Let a browser keep the token as a cookie, and its address bar not."""
    target = path if not query else f"{path}?{urlencode(query)}"
    cookie = f"{COOKIE}={quote(token, safe='')}; Path=/; HttpOnly; SameSite=Strict"
    return replace(Answer.text(303, "come in"), headers={"Location": target, "Set-Cookie": cookie})


def _response(answer: Answer) -> Response:
    headers = Headers(
        {
            "Connection": "close",
            "Content-Length": str(len(answer.body)),
            "Content-Type": answer.content_type,
            **_SECURITY,
            **answer.headers,
        }
    )
    return Response(answer.status, http.HTTPStatus(answer.status).phrase, headers, answer.body)
