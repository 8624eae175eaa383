"""Control over ZeroMQ: a REP socket that takes the operations of `chachart.sinks.operations`.

A request is one message, msgpack or JSON: `{"op": "spectrum", "ue": 7}`. The reply comes in the same
encoding: `{"ok": true, "result": {...}}` or `{"ok": false, "error": "..."}`; an error has changed nothing.
Once a token is set, requests must carry it as `"token"`; where keys are needed, the key says what one may do.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import msgpack
import zmq
from pydantic import Field

from chachart.node.data.errors import RequestError, SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.doorkeeper import Doorkeeper, key_problems, needs_keys
from chachart.node.net.endpoints import Endpoint, bind, bind_problems, fixed, is_local, is_loopback
from chachart.node.net.limits import GUESSES_AT_ONCE, GUESSES_PER_S, RateLimit, Refusals
from chachart.node.net.security import Role, SecuritySettings, Tokens, endpoint_exposure
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.operations import Operations
from chachart.sinks.plain import encoded, plain

MAX_REQUEST_BYTES = 16 * 1024
REQUESTS_A_TICK = 16
BURST_S = 5.0
_UNPACK = {"max_array_len": 64, "max_map_len": 64, "max_ext_len": 0}


class ControlSettings(SinkSettings):
    """`type = "control"`: lets programs ask and steer the node over ZeroMQ."""

    type: Literal["control"] = "control"
    endpoint: Endpoint = "tcp://127.0.0.1:5557"
    """Where the REP socket listens; anything but loopback and ipc needs keys, see [security]."""
    spare_ports: int = Field(0, ge=0, le=1000)
    """Where the port is in use, one of so many after it is taken instead; the log says which."""
    token: str | None = Field(None, min_length=16, repr=False)
    """What requests must carry, 16 characters or more; not set: as [security] says."""
    record_folder: Path = Field(Path("."), validate_default=False)
    """Where recordings go; a request names a file in it and nothing else."""

    def listens_on(self) -> str | None:
        """Its endpoint, unless any free one will do."""
        return fixed(self.endpoint)

    def exposure(self, security: SecuritySettings) -> list[str]:
        """An endpoint that other machines reach needs keys; without them at least a token."""
        found = endpoint_exposure('sink "control"', self.endpoint, security)
        with suppress(SetupError):  # a token that cannot be read is told once, for [security]
            open_to_all = security.keys is None and not Tokens.of(security, self.token)
            if not found and open_to_all and not is_local(self.endpoint):
                found.append(f'sink "control": a token must be set to listen on {self.endpoint} without keys')
        return found + key_problems(self.endpoint, security)


class Control(Sink):
    """Answers requests between the node's other calls, some twenty times a second."""

    Settings = ControlSettings

    def __init__(self, settings: ControlSettings, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self.refused = Refusals("control")
        self._operations: Operations | None = None
        self._context: zmq.Context[zmq.Socket[bytes]] | None = None
        self._doorkeeper: Doorkeeper | None = None
        self._socket: zmq.Socket[bytes] | None = None
        self._endpoint: str | None = None

    @classmethod
    def problems(cls, settings: ControlSettings) -> list[str]:
        """Whether the endpoint is free."""
        return bind_problems(settings.endpoint, settings.spare_ports)

    def open(self, node: NodeAccess | None) -> None:
        """Listen.

        Raises
        ------
        SetupError
            If the endpoint is in use or does not exist here.
        """
        if node is None:
            raise ValueError("control needs its node")
        self._operations = Operations(node, self.settings.record_folder)
        self._tokens = Tokens.of(self.security, self.settings.token)
        per_s = self.security.max_requests_per_s
        self._rate = RateLimit(per_s, BURST_S * per_s)
        self._guesses = RateLimit(GUESSES_PER_S, GUESSES_AT_ONCE)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.REP)
        self._socket.linger = 500
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        try:
            self._doorkeeper = Doorkeeper(self._context, self.security, self.refused, ("read", "steer"))
            self._doorkeeper.guard(self._socket, self.settings.endpoint)
            self._endpoint = bind(self._socket, self.settings.endpoint, self.settings.spare_ports)
        except SetupError:
            self.close()
            raise

    def on_tick(self) -> None:
        """Answer what waits."""
        assert self._socket is not None
        for _ in range(REQUESTS_A_TICK):
            try:
                parts = self._socket.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return
            reply = b""
            try:
                reply = self._answer(parts)
            finally:
                self._socket.send(reply)  # a REP socket that does not reply never hears again

    def close(self) -> None:
        """Let the socket go."""
        if self._doorkeeper is not None:
            self._doorkeeper.close()
            self._doorkeeper = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._context is not None:
            self._context.term()
            self._context = None

    def where(self) -> str | None:
        """The endpoint."""
        return self._endpoint

    def _answer(self, parts: list[zmq.Frame]) -> bytes:
        assert self._operations is not None
        body = parts[0].bytes
        encode = _json if body[:1] == b"{" else _msgpack
        try:
            request = decode_request(parts)
            role = self._admit(parts[0], request.pop("token", None))
            return self._operations.reply(request, role, _json_result if encode is _json else _msgpack_result)
        except RequestError as error:
            return encode({"ok": False, "error": str(error)})

    def _admit(self, frame: zmq.Frame, token: Any) -> Role:
        peer = str(frame.get("Peer-Address")) or "ipc"
        if not self._rate.take(peer):
            raise self._refusal("too_many_requests", "too many requests: wait a second")
        if needs_keys(self.settings.endpoint, self.security):
            right = str(frame.get("User-Id")).partition(":")[0]
            return Role.STEERER if right == "steer" else Role.READER
        if token is not None and self._tokens:
            if self._guesses.wait_s(peer):
                raise self._refusal("too_many_guesses", "too many wrong tokens: wait a few seconds")
            if role := self._tokens.role(token):
                return role
            self._guesses.take(peer)
            raise self._refusal("wrong_token", "that is not the token")
        local = is_local(self.settings.endpoint) or is_loopback(peer)
        if local and (self.security.trust_local or not self._tokens):
            return Role.STEERER
        raise self._refusal("no_token", "a token is needed")

    def _refusal(self, word: str, reason: str) -> RequestError:
        self.refused.add(word)
        return RequestError(reason)


def decode_request(parts: list[zmq.Frame]) -> dict[str, Any]:
    """The map that a request holds.

    Raises
    ------
    RequestError
        If it is none.
    """
    if len(parts) != 1:
        raise RequestError(f"a request is one message part, not {len(parts)}")
    body = parts[0].bytes
    try:
        request = json.loads(body) if body[:1] == b"{" else msgpack.unpackb(body, **_UNPACK)
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise RequestError(f"a request is a map in msgpack or JSON: {error}"[:200]) from None
    if not isinstance(request, dict) or not all(isinstance(key, str) for key in request):
        raise RequestError("a request is a map in msgpack or JSON")
    return request


def _json(reply: Mapping[str, Any]) -> bytes:
    return encoded(reply)


def _json_result(result: Mapping[str, Any]) -> bytes:
    return _json({"ok": True, "result": result})


def _msgpack_result(result: Mapping[str, Any]) -> bytes:
    return _msgpack({"ok": True, "result": result})


def _msgpack(reply: Mapping[str, Any]) -> bytes:
    return bytes(msgpack.packb(plain(reply)))
