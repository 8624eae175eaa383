"""The way to an ESPARGOS controller, and the usual one: HTTP and UDP over a network."""

from __future__ import annotations

import http.client
import json
import socket
from abc import abstractmethod
from contextlib import suppress

from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.sources.live.device import DeviceGone
from chachart.sources.live.espargos import stream
from chachart.sources.live.espargos.control import Controller

TIMEOUT_S = 3.0
LARGEST_ANSWER = 1 << 20
RECEIVE_BUFFER_BYTES = 16 << 20
LONGEST_DATAGRAM = 65535


class Link(Controller):
    """A controller and the sensor packets that it sends."""

    @abstractmethod
    def begin(self) -> None:
        """Have the controller send.

        Raises
        ------
        SetupError
            If it does not.
        """

    @abstractmethod
    def fileno(self) -> int:
        """What to wait for."""

    @abstractmethod
    def packets(self) -> list[bytes]:
        """The sensor packets that have come.

        Raises
        ------
        DeviceGone
            If the controller has gone.
        """

    @abstractmethod
    def keep_alive(self) -> None:
        """Show that somebody still listens.

        Raises
        ------
        DeviceGone
            If the controller has gone.
        """

    @abstractmethod
    def close(self) -> None:
        """Have the controller stop, and hang up. May be called twice."""


class NetworkLink(Link):
    """HTTP to ask, UDP to listen.

    Parameters
    ----------
    host
        The controller's address, with `:port` where that is not 80.
    udp_port
        Where it wants signs of life.
    rejected
        Where datagrams that come from elsewhere are counted, as `stranger`.
    """

    def __init__(self, host: str, udp_port: int, rejected: Counters) -> None:
        super().__init__(host)
        self._udp_port, self._rejected = udp_port, rejected
        self._socket: socket.socket | None = None
        self._address = ("", udp_port)

    def begin(self) -> None:
        """See `Link`."""
        receiver = self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        try:
            self._address = socket.gethostbyname(self.name.partition(":")[0]), self._udp_port
            receiver.bind((_local_address(self._address), 0))
            receiver.sendto(b"", self._address)
            self._stream(enable=True)
            receiver.settimeout(TIMEOUT_S)
            greeting, sender = receiver.recvfrom(LONGEST_DATAGRAM)
        except OSError as error:
            raise SetupError(f'[source] "{self.name}" does not begin to send: {error}') from None
        if greeting != stream.HELLO or sender[0] != self._address[0]:
            raise SetupError(f'[source] "{self.name}" begins with {greeting[:8].hex()}, not e5a76000')
        receiver.setblocking(False)

    def fileno(self) -> int:
        """See `Link`."""
        assert self._socket is not None
        return self._socket.fileno()

    def packets(self) -> list[bytes]:
        """See `Link`."""
        assert self._socket is not None
        try:
            packet, sender = self._socket.recvfrom(LONGEST_DATAGRAM)
        except BlockingIOError:
            return []
        except OSError as error:
            raise DeviceGone(str(error)) from None
        if sender[0] != self._address[0]:
            self._rejected.add("stranger")
            return []
        return [packet]

    def keep_alive(self) -> None:
        """See `Link`."""
        assert self._socket is not None
        try:
            self._socket.sendto(b"", self._address)
        except OSError as error:
            raise DeviceGone(str(error)) from None

    def close(self) -> None:
        """See `Link`."""
        if self._socket is None:
            return
        with suppress(SetupError):  # it may have gone: nothing is left to stop
            self._stream(enable=False)
        self._socket.close()
        self._socket = None

    def ask(self, method: str, path: str, body: str = "") -> tuple[int, str]:
        """See `Controller`."""
        try:
            connection = http.client.HTTPConnection(self.name, timeout=TIMEOUT_S)
            try:
                connection.request(method, path, body or None)
                response = connection.getresponse()
                return response.status, response.read(LARGEST_ANSWER).decode("utf-8", "replace")
            finally:
                connection.close()
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise SetupError(f'[source] ESPARGOS controller "{self.name}" does not answer: {error}') from None

    def _stream(self, *, enable: bool) -> None:
        assert self._socket is not None
        self.tell("/stream_udp", json.dumps({"enable": enable, "port": self._socket.getsockname()[1]}))


def _local_address(far: tuple[str, int]) -> str:
    """This machine's address on the way to `far`: where a controller's datagrams come in, and no others."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(far)
        return str(probe.getsockname()[0])
