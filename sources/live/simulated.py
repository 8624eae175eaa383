"""What all simulated devices have in common: a thread of the node's own at the other end of real sockets."""

from __future__ import annotations

import socket
import threading
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any

from chachart.node.data.errors import SetupError

Address = tuple[str, int]
ANY_PORT: Address = ("127.0.0.1", 0)


class SimulatedDevice(ABC):
    """A device in a thread of the node's own, at the other end of real sockets.

    Attributes
    ----------
    ended
        Set when it has played to its end.
    """

    def __init__(self) -> None:
        self.ended = threading.Event()

    @property
    @abstractmethod
    def where(self) -> str:
        """Where it listens, as settings that a source is given: `host=... port=...`."""

    @property
    @abstractmethod
    def report(self) -> Any:
        """A dataclass of counts: what has become of what it sent."""

    @abstractmethod
    def start(self) -> None:
        """Listen."""

    @abstractmethod
    def stop(self) -> None:
        """End everything. May be called twice."""


class SimulatedServer(SimulatedDevice):
    """A simulated device that listens on TCP and serves one client after another until it has played.

    Raises
    ------
    SetupError
        If it cannot listen at `address`.
    """

    def __init__(self, address: Address) -> None:
        super().__init__()
        self.stopping = threading.Event()
        try:
            self._listener = socket.create_server(address)
        except OSError as error:
            raise SetupError(f"{address[0]}:{address[1]} cannot be listened at: {error.strerror}") from None
        self._listener.settimeout(0.05)
        self._thread = threading.Thread(target=self.run, name="simulated device", daemon=True)

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._listener.getsockname()[1])

    @property
    def where(self) -> str:
        """Its address."""
        return f"host={self._listener.getsockname()[0]} port={self.port}"

    def start(self) -> None:
        """Listen."""
        self._thread.start()

    def stop(self) -> None:
        """End it."""
        self.stopping.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._listener.close()

    def run(self) -> None:
        """Serve clients, in the thread."""
        while not self.stopping.is_set() and not self.ended.is_set():
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            with client, suppress(OSError):  # the client has gone: wait for the next
                self.serve(client)

    @abstractmethod
    def serve(self, client: socket.socket) -> None:
        """Play to one client; an OSError ends that."""
