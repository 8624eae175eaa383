"""Who may connect to a listening ZeroMQ socket, how many, and how to get rid of one.

A doorkeeper answers the authentication requests (ZAP, https://rfc.zeromq.org/spec/27/) of one context in a
thread of its own, and watches which connections there are.
"""

from __future__ import annotations

import logging
import math
import os
import socket as socketlib
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import zmq
from zmq.utils.monitor import parse_monitor_message
from zmq.utils.z85 import encode

from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.node.net.endpoints import is_local
from chachart.node.net.keys import NODE, KeyPair, KeyRing, Right, serve_with
from chachart.node.net.security import SecuritySettings

log = logging.getLogger(__name__)

HANDSHAKE_MS = 5000
HEARTBEAT_MS, SILENCE_MS = 10_000, 30_000
REST_WITHIN_S = 0.2
"""The rest of a message that was cut off comes by then."""
_ZAP = "inproc://zeromq.zap.01"
_DOMAIN = b"chachart"
_EVENTS = zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
_EVENTS |= zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_AUTH
_FAILED = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL, zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL

CUT_OFF = "cut_off"
"""Refused: a connection ended within a message, which was longer than the socket takes."""


@dataclass(slots=True)
class Connection:
    """One connection: its far end, what it has subscribed to, and when it last got a whole chart."""

    peer: Any
    line: socketlib.socket | None = None
    topics: set[bytes] = field(default_factory=set)
    whole_at: float = -math.inf
    expelled: bool = False


class Doorkeeper:
    """Looks after one listening socket; `guard` it before it is bound, `close` before its context ends.

    Parameters
    ----------
    context
        The socket's; it must be the only one in it that is guarded.
    security
        Whose keys let in, and how many.
    refusals
        Counts who is turned away, by reason.
    rights
        Of keys that let in, weakest first.
    sees_cuts
        Whether connections that ZeroMQ ends because of too long a message are counted as `CUT_OFF`; that
        costs a descriptor for each connection.
    """

    def __init__(
        self,
        context: zmq.Context[Any],
        security: SecuritySettings,
        refusals: Counters,
        rights: tuple[Right, ...],
        sees_cuts: bool = False,
    ) -> None:
        self._context = context
        self._security = security
        self._refusals = refusals
        self._rights = rights
        self._sees_cuts = sees_cuts
        self._ring: KeyRing | None = None
        self._open: dict[int, Connection] = {}
        self._failing = False
        self._lock = threading.Lock()
        self._stop = context.socket(zmq.PAIR)
        self._stop.bind(f"inproc://doorkeeper-{id(self)}")
        self._zap = context.socket(zmq.REP)
        self._zap.bind(_ZAP)
        self._monitor: zmq.Socket[bytes] | None = None
        self._socket: zmq.Socket[Any] | None = None
        self._thread: threading.Thread | None = None

    def guard(self, socket: zmq.Socket[Any], endpoint: str) -> None:
        """Set the options of a socket that will listen on `endpoint`, and watch it from now on.

        Raises
        ------
        SetupError
            If the node's own keys cannot be read.
        """
        security = self._security
        if security.keys is not None and needs_keys(endpoint, security):
            serve_with(socket, KeyPair.load(security.keys / f"{NODE}.key_secret"))
            self._ring = KeyRing(security.keys, self._rights)
        elif not is_local(endpoint):
            log.warning("%s takes anybody who reaches it: [security] without_keys says so", endpoint)
        socket.zap_domain = _DOMAIN
        socket.handshake_ivl = HANDSHAKE_MS
        socket.heartbeat_ivl, socket.heartbeat_timeout = HEARTBEAT_MS, SILENCE_MS
        self._socket = socket
        address = f"inproc://connections-{id(self)}"
        socket.monitor(address, _EVENTS)
        self._monitor = self._context.socket(zmq.PAIR)
        self._monitor.rcvhwm = 0
        self._monitor.connect(address)
        self._thread = threading.Thread(target=self._run, name="doorkeeper", daemon=True)
        self._thread.start()

    @property
    def connections(self) -> int:
        """How many there are."""
        return len(self._open)

    def connection(self, fd: int) -> Connection | None:
        """The connection behind a file descriptor, as a message's SRCFD names it; None once it has gone."""
        with self._lock:
            return self._open.get(fd)

    def expel(self, fd: int, reason: str) -> None:
        """End a connection, and count it."""
        with self._lock:
            known = self._open.get(fd)
            # The number may be another connection's by now.
            if known is None or known.expelled or known.peer is None or _peer(fd) != known.peer:
                return
            known.expelled = True
            self._refusals.add(reason)
            with suppress(OSError), socketlib.socket(fileno=os.dup(fd)) as connection:
                connection.shutdown(socketlib.SHUT_RDWR)

    def close(self) -> None:
        """End the thread and its sockets. May be called twice."""
        if self._thread is not None:
            with self._context.socket(zmq.PAIR) as word:
                word.connect(f"inproc://doorkeeper-{id(self)}")
                word.send(b"")
                self._thread.join()
            self._thread = None
        if self._socket is not None and not self._socket.closed:
            self._socket.disable_monitor()
        for socket in (self._stop, self._zap, self._monitor):
            if socket is not None:
                socket.close(linger=0)
        for known in self._open.values():
            if known.line is not None:
                known.line.close()
        self._open.clear()

    def _run(self) -> None:
        assert self._monitor is not None
        poller = zmq.Poller()
        for socket in (self._stop, self._zap, self._monitor):
            poller.register(socket, zmq.POLLIN)
        while True:
            ready = dict(poller.poll())
            if self._stop in ready:
                return
            if self._monitor in ready or self._zap in ready:  # whoever asks to come in is known by then
                self._watch(self._monitor)
            if self._zap in ready:
                self._zap.send_multipart(self._decide(self._zap.recv_multipart()))

    def _watch(self, monitor: zmq.Socket[bytes]) -> None:
        while monitor.poll(0):
            event = parse_monitor_message(monitor.recv_multipart())
            kind, fd = event["event"], event["value"]
            with self._lock:
                if kind == zmq.EVENT_ACCEPTED:
                    self._open[fd] = Connection(_peer(fd), _line(fd) if self._sees_cuts else None)
                elif kind == zmq.EVENT_DISCONNECTED and (gone := self._open.pop(fd, None)) is not None:
                    self._see_off(gone, self._failing)
            # ZeroMQ says why a handshake fails just before it says that the connection is gone.
            self._failing = kind in _FAILED or kind == zmq.EVENT_HANDSHAKE_FAILED_AUTH
            if kind in _FAILED:
                self._refusals.add("no_handshake")

    def _see_off(self, gone: Connection, after_failure: bool) -> None:
        """A peer that goes leaves nothing unread: else ZeroMQ has ended the connection within a message."""
        if gone.line is None:
            return
        with gone.line as line, suppress(OSError):  # nothing came any more, or it was reset
            line.shutdown(socketlib.SHUT_WR)
            line.settimeout(REST_WITHIN_S)
            if line.recv(1, socketlib.MSG_PEEK) and not after_failure and not gone.expelled:
                self._refusals.add(CUT_OFF)

    def _decide(self, request: list[bytes]) -> list[bytes]:
        """The answer to an authentication request."""
        _, number, _, _, _, mechanism, *credentials = request
        status, text, user = b"200", b"OK", b""
        if len(self._open) > self._security.max_connections:
            self._refusals.add("too_many_connections")
            status, text = b"400", b"too many connections"
        elif self._ring is not None:
            key = encode(credentials[0]) if mechanism == b"CURVE" and credentials else b""
            found = self._ring.who(key)
            if found is None:
                self._refusals.add("unknown_key")
                status, text = b"400", b"this key may not connect"
            else:
                user = ":".join(found).encode()
        return [b"1.0", number, status, text, user, b""]


def _line(fd: int) -> socketlib.socket | None:
    """The connection itself, to look at once ZeroMQ is done with it."""
    try:
        return socketlib.socket(fileno=os.dup(fd))
    except OSError:  # it has gone already
        return None


def needs_keys(endpoint: str, security: SecuritySettings) -> bool:
    """Whether whoever connects to `endpoint` needs a key."""
    if security.keys is None or endpoint in security.without_keys:
        return False
    return not (security.trust_local and is_local(endpoint))


def key_problems(endpoint: str, security: SecuritySettings) -> list[str]:
    """What would keep a socket on `endpoint` from taking peers with keys."""
    if security.keys is not None and security.keys.is_dir() and needs_keys(endpoint, security):
        try:
            KeyPair.load(security.keys / f"{NODE}.key_secret")
        except SetupError as error:
            return [f"[security]: {error}"]
    return []


def _peer(fd: int) -> Any:
    """The far end of a connection; None where it has gone."""
    try:
        with socketlib.socket(fileno=os.dup(fd)) as connection:
            return connection.getpeername()
    except OSError:
        return None
