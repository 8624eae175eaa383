"""Control over ZeroMQ: a REP socket that takes the operations of `chachart.sinks.operations`.

A request is one message, msgpack or JSON: `{"op": "spectrum", "ue": 7}`. The reply comes in the same
encoding: `{"ok": true, "result": {...}}` or `{"ok": false, "error": "..."}`; an error has changed nothing.
From another machine the request must carry `"token"`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, Self
from urllib.parse import urlsplit

import msgpack
import zmq
from pydantic import Field, model_validator

from chachart.node.data.errors import RequestError, SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.endpoints import Endpoint, bind, bind_problems, fixed
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.operations import Operations
from chachart.sinks.web.access import is_loopback, same_token

MAX_REQUEST_BYTES = 16 * 1024
REQUESTS_A_TICK = 16


class ControlSettings(SinkSettings):
    """`type = "control"`: lets programs ask and steer the node over ZeroMQ."""

    type: Literal["control"] = "control"
    endpoint: Endpoint = "tcp://127.0.0.1:5557"
    """Where the REP socket listens; anything but loopback and ipc needs a token."""
    spare_ports: int = Field(0, ge=0, le=1000)
    """Where the port is in use, one of so many after it is taken instead; the log says which."""
    token: str | None = Field(None, min_length=16, repr=False)
    """What requests from other machines must carry: 16 characters or more."""
    record_folder: Path = Field(Path("."), validate_default=False)
    """Where recordings go; a request names a file in it and nothing else."""

    @model_validator(mode="after")
    def _closed_to_strangers(self) -> Self:
        if self.token is None and not _is_local(self.endpoint):
            raise ValueError(f"token must be set to listen on {self.endpoint}, which others can reach")
        return self

    def listens_on(self) -> str | None:
        """Its endpoint, unless any free one will do."""
        return fixed(self.endpoint)


class Control(Sink):
    """Answers requests between the node's other calls, some twenty times a second."""

    Settings = ControlSettings

    def __init__(self, settings: ControlSettings, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._operations: Operations | None = None
        self._context: zmq.Context[zmq.Socket[bytes]] | None = None
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
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.REP)
        self._socket.linger = 500
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        try:
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
            request = _decode(parts)
            self._admit(parts[0], request.pop("token", None))
            return encode({"ok": True, "result": self._operations.perform(request)})
        except RequestError as error:
            return encode({"ok": False, "error": str(error)})

    def _admit(self, frame: zmq.Frame, token: Any) -> None:
        if _is_local(self.settings.endpoint) or is_loopback(str(frame.get("Peer-Address"))):
            return
        if not same_token(token, self.settings.token):
            raise RequestError("a token is needed")


def _decode(parts: list[zmq.Frame]) -> dict[str, Any]:
    if len(parts) != 1:
        raise RequestError(f"a request is one message part, not {len(parts)}")
    body = parts[0].bytes
    try:
        request = json.loads(body) if body[:1] == b"{" else msgpack.unpackb(body)
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise RequestError(f"a request is a map in msgpack or JSON: {error}"[:200]) from None
    if not isinstance(request, dict) or not all(isinstance(key, str) for key in request):
        raise RequestError("a request is a map in msgpack or JSON")
    return request


def _json(reply: dict[str, Any]) -> bytes:
    return json.dumps(reply).encode()


def _msgpack(reply: dict[str, Any]) -> bytes:
    return bytes(msgpack.packb(reply))


def _is_local(endpoint: str) -> bool:
    if endpoint.startswith("ipc://"):
        return True
    try:
        return is_loopback(urlsplit(endpoint).hostname or "")
    except ValueError:
        return False
