"""ZeroMQ endpoints of a configuration: `tcp://127.0.0.1:5556`, `ipc:///run/chart`."""

from __future__ import annotations

import ipaddress
import socket as socketlib
from pathlib import Path
from typing import Annotated, Any

import zmq
from pydantic import Field

from chachart.node.data.errors import SetupError
from chachart.node.data.settings import Means

Endpoint = Annotated[
    str,
    Field(pattern=r"^(tcp|ipc)://\S+$", max_length=256),
    Means("that is an endpoint, such as tcp://127.0.0.1:5556 or ipc:///run/chart"),
]
"""A setting that names an endpoint."""


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this machine's own, for sure.

    >>> is_loopback("127.0.0.2"), is_loopback("::1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, True, False)
    """
    if host.lower() == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host.strip("[]").split("%")[0])
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return bool((mapped or address).is_loopback)


def is_local(endpoint: str) -> bool:
    """Whether only this machine reaches an endpoint.

    >>> is_local("ipc:///run/chart"), is_local("tcp://[::1]:5556"), is_local("tcp://*:5556")
    (True, True, False)
    """
    if endpoint.startswith("ipc://"):
        return True
    return is_loopback(endpoint.removeprefix("tcp://").rpartition(":")[0])


def bind(socket: zmq.Socket[Any], endpoint: str, spare_ports: int = 0) -> str:
    """Bind `socket`; the endpoint it really has (`tcp://127.0.0.1:0` gets a free port).

    Where the port is in use, one of the `spare_ports` after it is taken instead.

    Raises
    ------
    SetupError
        If the endpoint is in use or does not exist here.
    """
    if not _port_exists(endpoint):
        raise SetupError(f"cannot listen on {endpoint}: a port is a number from 0 to 65535")
    if _ipc_in_use(endpoint):
        raise SetupError(f"cannot listen on {endpoint}: Address already in use")
    socket.ipv6 = "[" in endpoint
    try:
        socket.bind(endpoint)
    except zmq.ZMQError as error:
        host, _, port = endpoint.rpartition(":")
        if spare_ports and error.errno == zmq.EADDRINUSE and port.isdigit() and int(port) < 65535:
            return bind(socket, f"{host}:{int(port) + 1}", spare_ports - 1)
        raise SetupError(f"cannot listen on {endpoint}: {zmq.strerror(error.errno or 0)}") from None
    return socket.getsockopt_string(zmq.LAST_ENDPOINT)


def connect(socket: zmq.Socket[Any], endpoint: str) -> str:
    """Connect `socket`, now or when somebody listens there; the endpoint.

    Raises
    ------
    SetupError
        If the endpoint makes no sense.
    """
    if not _port_exists(endpoint):
        raise SetupError(f"cannot connect to {endpoint}: a port is a number from 1 to 65535")
    socket.ipv6 = "[" in endpoint
    try:
        socket.connect(endpoint)
    except zmq.ZMQError as error:
        raise SetupError(f"cannot connect to {endpoint}: {zmq.strerror(error.errno or 0)}") from None
    return endpoint


def bind_problems(endpoint: str, spare_ports: int = 0) -> list[str]:
    """What would keep a socket from listening on `endpoint` now."""
    with zmq.Context() as context, context.socket(zmq.PULL) as socket:
        try:
            bind(socket, endpoint, spare_ports)
        except SetupError as error:
            return [str(error)]
    return []


def fixed(endpoint: str) -> str | None:
    """The endpoint, or None where its port is any that is free."""
    return None if endpoint.endswith((":0", ":*")) else endpoint


def _port_exists(endpoint: str) -> bool:
    """Whether a `tcp://` port fits into 16 bits: ZeroMQ itself would take the rest of a larger number."""
    port = endpoint.rpartition(":")[2]
    return not (endpoint.startswith("tcp://") and port.isdigit() and int(port) > 65535)


def _ipc_in_use(endpoint: str) -> bool:
    """Whether somebody listens on this `ipc://` path: ZeroMQ itself would take it away from them."""
    path = endpoint.removeprefix("ipc://")
    if path == endpoint or not Path(path).is_socket():
        return False
    with socketlib.socket(socketlib.AF_UNIX, socketlib.SOCK_STREAM) as probe:
        try:
            probe.connect(path)
        except OSError:
            return False
    return True
