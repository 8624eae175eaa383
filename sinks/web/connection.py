"""A connection that also reads what a form sends, and one too many that is turned away.

The `websockets` library takes requests without a body only: here a short body is kept for whoever answers,
and a long one, or one of unknown length, gets an answer instead of silence.
"""

from __future__ import annotations

import asyncio
import re
from typing import Any, cast

from websockets.asyncio.server import ServerConnection

from chachart.node.net.limits import Refusals
from chachart.node.net.security import Role
from chachart.sinks.web.answers import Answer

LONGEST_HEAD = 64 * 1024
LONGEST_BODY = 16 * 1024
_BODY_HEADER = re.compile(rb"^(content-length|transfer-encoding)[ \t]*:[ \t]*(.*?)[ \t]*\r?\n", re.I | re.M)
LONGEST_LINE, MOST_LINES = 8190, 128
"""Of a head; the library ends a connection beyond, and says nothing to whoever sends no HTTP."""
HEAR_OUT_S = 1.0
_BUSY = Answer.text(503, "too many connections").with_headers(Retry_After="5")
_TOO_LARGE = Answer.text(431, f"lines of at most {LONGEST_LINE} bytes, at most {MOST_LINES} of them")
_NO_HTTP = Answer.text(400, "this is no HTTP request")
_REQUEST = re.compile(rb"[A-Z]{1,16} [!-~]+ HTTP/1\.[01]")
_HEADER = re.compile(rb"[!#$%&'*+\-.^_`|~0-9A-Za-z]+:[\t\x20-\x7e\x80-\xff]*")


class Connections:
    """How many there are, and how many there may be."""

    def __init__(self, most: int, refusals: Refusals) -> None:
        self.most = most
        self.open = 0
        self.refusals = refusals


class WebConnection(ServerConnection):
    """One connection to the server.

    Attributes
    ----------
    role
        What the one at the other end may do; nothing until a request has been admitted.
    body
        What came behind the headers.
    mistake
        HTTP status and reason where a request has a body that is not taken.
    """

    def __init__(self, *arguments: Any, connections: Connections, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.role = Role.NOBODY
        self.body = b""
        self.mistake: tuple[int, str] | None = None
        self._connections = connections
        self._refused = False
        self._gathered: bytearray | None = bytearray()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Count it, or turn it away."""
        if self._connections.open >= self._connections.most:
            self._refused = True
            self._connections.refusals.add("too_many_connections")
            cast(asyncio.Transport, transport).write(_BUSY.response().serialize())
            cast(asyncio.Transport, transport).close()
            return
        self._connections.open += 1
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Count it no more."""
        if not self._refused:
            self._connections.open -= 1
            super().connection_lost(exc)

    def eof_received(self) -> None:
        """The other end has said all."""
        if not self._refused:
            super().eof_received()

    def data_received(self, data: bytes) -> None:
        """Gather headers and body, then hand the headers on; later bytes as they come."""
        if self._refused:
            return
        if self._gathered is None:
            if self.mistake is None:
                super().data_received(data)
            return
        self._gathered += data
        end = self._gathered.find(b"\r\n\r\n") + 4
        if end < 4:
            if len(self._gathered) > LONGEST_HEAD:
                self._give_up(_TOO_LARGE)
            return
        head = bytes(self._gathered[:end])
        if answer := _unreadable(head):
            self._give_up(answer)
            return
        length = self._body_length(head)
        if self.mistake is None and len(self._gathered) < end + length:
            return
        self.body = bytes(self._gathered[end : end + length])
        rest = b"" if self.mistake else bytes(self._gathered[end + length :])
        self._hand_on(_BODY_HEADER.sub(b"", head) + rest)

    def _give_up(self, answer: Answer) -> None:
        self._connections.refusals.add("no_request")
        self._gathered, self.mistake = None, (answer.status, "")
        self.transport.write(answer.response().serialize())
        if self.transport.can_write_eof():
            # To close while the other end still sends would take the answer from it.
            self.transport.write_eof()
            self.loop.call_later(HEAR_OUT_S, self.transport.close)
        else:
            self.transport.close()

    def _hand_on(self, data: bytes) -> None:
        self._gathered = None
        super().data_received(data)

    def _body_length(self, head: bytes) -> int:
        """How long the body is; `mistake` says why it is not taken."""
        found = [(name.lower(), value) for name, value in _BODY_HEADER.findall(head)]
        if not found:
            return 0
        if len(found) > 1 or found[0][0] != b"content-length":
            self.mistake = 411, "a body needs one Content-Length, and no Transfer-Encoding"
            return 0
        value = found[0][1]
        if not re.fullmatch(rb"[0-9]{1,18}", value):
            self.mistake = 400, "Content-Length must be a number"
            return 0
        if int(value) > LONGEST_BODY:
            self.mistake = 413, f"a body may have {LONGEST_BODY} bytes; arguments go into the query"
            return 0
        return int(value)


def _unreadable(head: bytes) -> Answer | None:
    """What to answer to a head that the library would not read."""
    request, *headers = head.removesuffix(b"\r\n\r\n").split(b"\r\n")
    if len(headers) > MOST_LINES or max(map(len, (request, *headers))) > LONGEST_LINE:
        return _TOO_LARGE
    if _REQUEST.fullmatch(request) and all(map(_HEADER.fullmatch, headers)):
        return None
    return _NO_HTTP
