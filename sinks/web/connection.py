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

LONGEST_HEAD = 64 * 1024
LONGEST_BODY = 16 * 1024
_BODY_HEADER = re.compile(rb"^(content-length|transfer-encoding)[ \t]*:[ \t]*(.*?)[ \t]*\r?\n", re.I | re.M)
_BUSY = (
    b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nRetry-After: 5\r\n"
    b"Content-Type: text/plain\r\nContent-Length: 21\r\n\r\ntoo many connections\n"
)


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
            cast(asyncio.Transport, transport).write(_BUSY)
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
                self._hand_on(bytes(self._gathered))  # the library says what is wrong with it
            return
        head = bytes(self._gathered[:end])
        length = self._body_length(head)
        if self.mistake is None and len(self._gathered) < end + length:
            return
        self.body = bytes(self._gathered[end : end + length])
        rest = b"" if self.mistake else bytes(self._gathered[end + length :])
        self._hand_on(_BODY_HEADER.sub(b"", head) + rest)

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
