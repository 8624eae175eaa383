"""The server: plain requests by routes, WebSocket connections by one handler, all on one port.

Arguments travel in the query string, for POST as well; each plain request closes its connection. What may
take long runs in a few threads of its own.
"""

from __future__ import annotations

import asyncio
import json
import logging
import threading
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar, cast
from urllib.parse import parse_qsl, urlencode

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import MultipleValuesError
from websockets.http11 import Request, Response

from chachart.node.data.errors import RequestError, SetupError
from chachart.node.net.limits import RateLimit, Refusals
from chachart.node.net.security import Role, SecuritySettings, Tokens
from chachart.sinks.web.access import COOKIE, Access, Refusal
from chachart.sinks.web.answers import HTML, JSON, SECURITY, Answer, Query, Route
from chachart.sinks.web.connection import Connections, WebConnection
from chachart.sinks.web.settings import WebSettings, cannot_listen, ports

THREADS = 4
WAITING_LIMIT = 64
CLOSE_WITHIN_S = 2.0
OPEN_WITHIN_S = 10.0
MAX_MESSAGE_BYTES = 16 * 1024
BURST_S = 5.0

T = TypeVar("T")

log = logging.getLogger(__name__)
_connections = logging.getLogger(f"{__name__}.connections")
_connections.setLevel(logging.WARNING)

Handler = Callable[[WebConnection], Awaitable[None]]


class WebServer:
    """Serves until it is stopped.

    Parameters
    ----------
    settings, security
        Where, and for whom.
    routes
        By `"METHOD /path"`.
    socket
        Handles WebSocket connections to `/ws`; None if there are none.
    beside
        Runs in the server's loop for as long as it serves.
    sign_in_page
        HTML page for people who need a token; plain text where there is none.
    """

    def __init__(
        self,
        settings: WebSettings,
        routes: Mapping[str, Route],
        socket: Handler | None = None,
        beside: Callable[[], Coroutine[Any, Any, None]] | None = None,
        sign_in_page: bytes | None = None,
        security: SecuritySettings | None = None,
    ) -> None:
        security = security or SecuritySettings()
        self._settings = settings
        self._routes = routes
        self._socket = socket
        self._beside = beside
        self._sign_in_page = sign_in_page
        self.refusals = Refusals(settings.type)
        self._access = Access(Tokens.of(security, settings.token), security.trust_local)
        self._tls = settings.tls(security)
        self._rate = RateLimit(security.max_requests_per_s, BURST_S * security.max_requests_per_s)
        self._open = Connections(security.max_connections, self.refusals)
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
            raise SetupError(cannot_listen(self._settings, self._failure))

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
        scheme = "http" if self._tls is None else "https"
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}"

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
        self._loop.set_exception_handler(self._on_trouble)
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

    def _on_trouble(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Without a descriptor for a connection asyncio tries again in a second, and says so each time."""
        if "out of system resource" in context.get("message", ""):
            self.refusals.add("no_descriptor_left")
        else:
            loop.default_exception_handler(context)

    async def _listen(self) -> Server:
        """On the first port that can be had."""
        failure = OSError("there is no port")
        for port in ports(self._settings):
            try:
                return await serve(
                    self._handle,
                    self._settings.host,
                    port,
                    ssl=self._tls,
                    create_connection=cast(
                        type[ServerConnection], partial(WebConnection, connections=self._open)
                    ),
                    process_request=self._process,
                    process_response=self._complete,
                    compression=None,
                    open_timeout=OPEN_WITHIN_S,
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
            await self._socket(cast(WebConnection, connection))

    async def _process(self, connection: ServerConnection, request: Request) -> Response | None:
        answer = await self._decide(cast(WebConnection, connection), request)
        return None if answer is None else answer.response(head=request.method == "HEAD")

    async def _complete(self, connection: ServerConnection, request: Request, response: Response) -> Response:
        """What the library answers itself, to who asks for a WebSocket wrongly, has our headers, too."""
        for name, value in SECURITY.items():
            response.headers.setdefault(name, value)
        return response

    async def _decide(self, connection: WebConnection, request: Request) -> Answer | None:
        """The answer to a request, or None for one that becomes a WebSocket."""
        peer = str(connection.remote_address[0])
        if not self._rate.take(peer):
            self.refusals.add("too_many_requests")
            return Answer.text(429, "too many requests").with_headers(Retry_After="1")
        if connection.mistake is not None:
            self.refusals.add("body")
            return Answer.text(*connection.mistake)
        path, _, text = request.path.partition("?")
        try:
            query = dict(parse_qsl(text, max_num_fields=32))
            given = query.pop("token", None)
            role = self._access.admit(peer, request.headers, given, self._cookie)
        except MultipleValuesError as error:
            return Answer.text(400, f"the header {error} occurs twice")
        except ValueError:
            return Answer.text(400, "a query has at most 32 arguments")
        if (request.method, path) == ("POST", "/login"):
            return self._sign_in(peer, connection.body, role)
        if (request.method, path) == ("POST", "/logout"):
            gone = f"{self._cookie}=; Path=/; Max-Age=0; HttpOnly; SameSite=Strict"
            return Answer.text(303, "goodbye").with_headers(Location="/", Set_Cookie=gone)
        if isinstance(role, Refusal):
            return self._turn_away(role)
        connection.role = role
        if path == "/ws" and self._socket is not None:
            return None
        in_browser = "text/html" in ",".join(request.headers.get_all("Accept"))
        if given is not None and self._access.tokens and in_browser:
            return self._remember(role, f"{path}?{urlencode(query)}" if query else path)
        return await self._answer(request.method, path, query, role)

    async def _answer(self, method: str, path: str, query: Query, role: Role) -> Answer:
        route = self._routes.get(f"{'GET' if method == 'HEAD' else method} {path}")
        if route is None:
            allowed = [name.split()[0] for name in self._routes if name.split()[1] == path]
            if allowed:
                return Answer.text(405, f"{path} takes {', '.join(allowed)}").with_headers(
                    Allow=", ".join(allowed)
                )
            return Answer.text(404, f"there is no {path[:100]}")
        if method == "POST" and role < Role.STEERER:
            return self._turn_away(Refusal(403, "the reading token steers nothing", "reader"))
        try:
            return await self.call(partial(route, query))
        except RequestError as error:
            return Answer(json.dumps({"error": str(error)}).encode(), JSON, 400)

    def _turn_away(self, refusal: Refusal) -> Answer:
        self.refusals.add(refusal.word)
        answer = Answer.text(refusal.status, refusal.reason)
        if refusal.status == 401:
            if self._sign_in_page is not None:
                page = self._sign_in_page.replace(b"<!-- reason -->", refusal.reason.encode())
                answer = Answer(page, HTML, 401)
            return answer.with_headers(WWW_Authenticate='Bearer realm="chachart"')
        return answer.with_headers(Retry_After="5") if refusal.status == 429 else answer

    def _sign_in(self, peer: str, body: bytes, role: Role | Refusal) -> Answer:
        """Take the token that a form has sent."""
        if isinstance(role, Refusal) and role.status == 403:
            return self._turn_away(role)
        form = dict(parse_qsl(body.decode(errors="replace"), max_num_fields=8))
        signed_in = self._access.sign_in(peer, form.get("token", ""))
        if isinstance(signed_in, Refusal):
            return self._turn_away(signed_in)
        return self._remember(signed_in, "/")

    @property
    def _cookie(self) -> str:
        """Name of the cookie; browsers tell ports of a host apart by nothing else."""
        return f"{COOKIE}_{self.port}"

    def _remember(self, role: Role, target: str) -> Answer:
        """Let a browser keep a cookie, and its address bar no token; it goes to a page of this server."""
        if f"GET {target.partition('?')[0]}" not in self._routes:
            target = "/"
        secure = "" if self._tls is None else "; Secure"
        cookie = (
            f"{self._cookie}={self._access.tokens.cookie(role)}; Path=/; HttpOnly; SameSite=Strict{secure}"
        )
        return Answer.text(303, "come in").with_headers(Location=target, Set_Cookie=cookie)


def _complain(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        log.error("the web server's own work failed: %s", error, exc_info=error)
