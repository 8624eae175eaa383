"""The ways on which records of Wi-Fi tools come: datagrams, TCP, a serial port, standard input."""

from __future__ import annotations

import os
import select
import socket
from abc import ABC, abstractmethod
from contextlib import suppress

from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.sources.live.device import DeviceGone
from chachart.sources.live.simulated import Address

READ_BYTES = 1 << 16
LONGEST_DATAGRAM = 65535
RECEIVE_BUFFER_BYTES = 8 << 20
DATAGRAMS_AT_ONCE = 256
ETH_P_IP = 0x0800


class Way(ABC):
    """Where pieces come from: datagrams whole, streams as they come."""

    @abstractmethod
    def pieces(self, timeout: float) -> list[bytes]:
        """What has come; nothing if nothing came within `timeout` seconds.

        Raises
        ------
        DeviceGone
            If nothing will come any more on this way.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of it."""


class Udp(Way):
    """A UDP socket; with `ask`, a command is sent to `far` first, and `stop` at the end.

    Raises
    ------
    SetupError
        If it cannot listen, or `far` is no address.
    """

    def __init__(self, near: Address, far: Address | None = None, ask: str = "", stop: str = "") -> None:
        self._far, self._stop = far, stop
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            self._socket.bind(near)
            if far is not None:
                self._socket.connect(far)  # nobody else's datagrams come in
                self._socket.send(ask.encode())
        except OSError as error:
            self._socket.close()
            where = far or near
            raise SetupError(
                f"[source] {where[0]}:{where[1]} cannot be used: {error.strerror or error}"
            ) from None
        self._socket.setblocking(False)

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._socket.getsockname()[1])

    def pieces(self, timeout: float) -> list[bytes]:
        """See `Way`."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return []
        return _waiting(self._socket)

    def close(self) -> None:
        """See `Way`."""
        if self._far is not None and self._stop:
            with suppress(OSError):  # the tool may have gone: nothing is left to stop
                self._socket.send(self._stop.encode())
        self._socket.close()


class TcpServer(Way):
    """A TCP port to which a tool connects; one at a time, the next when it has gone.

    Raises
    ------
    SetupError
        If it cannot listen.
    """

    def __init__(self, near: Address) -> None:
        try:
            self._listener = socket.create_server(near)
        except OSError as error:
            raise SetupError(
                f"[source] {near[0]}:{near[1]} cannot be listened at: {error.strerror}"
            ) from None
        self._tool: socket.socket | None = None

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._listener.getsockname()[1])

    def pieces(self, timeout: float) -> list[bytes]:
        """See `Way`."""
        waiting = self._tool or self._listener
        if not select.select([waiting], [], [], timeout)[0]:
            return []
        if self._tool is None:
            self._tool, _ = self._listener.accept()
            return []
        try:
            piece = self._tool.recv(READ_BYTES)
        except OSError as error:
            raise DeviceGone(str(error)) from None
        if not piece:
            raise DeviceGone("the tool has hung up")
        return [piece]

    def close(self) -> None:
        """See `Way`."""
        if self._tool is not None:
            self._tool.close()
        self._listener.close()


class SerialPort(Way):
    """A serial port.

    Raises
    ------
    SetupError
        If it cannot be opened.
    """

    def __init__(self, port: str, baudrate: int) -> None:
        require("serial", "[source]")
        import serial

        try:
            self._serial = serial.serial_for_url(port, baudrate=baudrate, timeout=0, exclusive=True)
            self._serial.fileno()  # raises where there is nothing to wait for
        except (serial.SerialException, OSError, ValueError) as error:
            raise SetupError(f'[source] serial port "{port}" cannot be opened: {error}') from None

    def pieces(self, timeout: float) -> list[bytes]:
        """See `Way`."""
        try:
            if not select.select([self._serial], [], [], timeout)[0]:
                return []
            piece: bytes = self._serial.read(READ_BYTES)
        except OSError as error:
            raise DeviceGone(str(error)) from None
        return [piece] if piece else []

    def close(self) -> None:
        """See `Way`."""
        self._serial.close()


class StandardInput(Way):
    """Standard input, as of `tcpdump -U -w - | chachart-node`, or another open file."""

    def __init__(self, file: int = 0) -> None:
        self._file, self._ended = file, False

    def pieces(self, timeout: float) -> list[bytes]:
        """See `Way`."""
        if self._ended:
            raise DeviceGone("standard input has ended")
        if not select.select([self._file], [], [], timeout)[0]:
            return []
        piece = os.read(self._file, READ_BYTES)
        self._ended = not piece
        return [piece] if piece else []

    def close(self) -> None:
        """It stays open."""


class EthernetFrames(Way):
    """A network interface, as tcpdump would listen to it: for tools whose datagrams no socket gets to see.

    Raises
    ------
    SetupError
        If there is no such interface, or this user may not listen to it.
    """

    def __init__(self, interface: str) -> None:
        try:
            self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_IP))
            self._socket.bind((interface, 0))
        except OSError as error:
            raise SetupError(
                f'[source] interface "{interface}" cannot be listened to: {error.strerror} (are you root?)'
            ) from None
        self._socket.setblocking(False)

    def pieces(self, timeout: float) -> list[bytes]:
        """See `Way`."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return []
        return _waiting(self._socket)

    def close(self) -> None:
        """See `Way`."""
        self._socket.close()


def _waiting(receiver: socket.socket) -> list[bytes]:
    """The datagrams that wait, some at a time."""
    found: list[bytes] = []
    try:
        while len(found) < DATAGRAMS_AT_ONCE:
            found.append(receiver.recv(LONGEST_DATAGRAM))
    except BlockingIOError:
        return found
    except OSError as error:
        raise DeviceGone(str(error)) from None
    return found
