"""The main process's end of the node's inner sockets, in a private directory that is gone afterwards."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any

import zmq

from chachart.node.data.errors import SetupError
from chachart.node.runtime import messages

LONGEST_PATH = 107
"""Of a Unix socket, in bytes."""
LONGEST_NAME = len("/commands")
AT_ONCE = 256
"""Results taken before anything else gets its turn."""


class Links:
    """Results from the feeder, commands to it.

    Attributes
    ----------
    directory
        Where the sockets are; nobody else may look into it.
    endpoints
        `workers`, `results`, `commands` and `quality`: Unix sockets, whose paths must stay short (107 bytes).
    """

    def __init__(self) -> None:
        self.directory = _short_directory()
        names = ("workers", "results", "commands", "quality")
        self.endpoints = {name: f"ipc://{self.directory / name}" for name in names}
        self._context = zmq.Context()
        self._results = self._context.socket(zmq.PULL)
        self._results.bind(self.endpoints["results"])
        self._commands = self._context.socket(zmq.PUSH)
        self._commands.connect(self.endpoints["commands"])
        self._lock = threading.Lock()

    def of_source(self, number: int) -> str:
        """Where one of several source processes meets the feeder process."""
        return f"ipc://{self.directory / f's{number}'}"

    def receive(self, timeout: float) -> list[list[bytes]]:
        """The results that are there, after waiting at most `timeout` seconds for the first."""
        received: list[list[bytes]] = []
        if self._results.poll(int(timeout * 1e3)):
            try:
                while len(received) < AT_ONCE:
                    received.append(self._results.recv_multipart(zmq.NOBLOCK))
            except zmq.Again:
                pass
        return received

    def command(self, kind: bytes, values: dict[str, Any]) -> None:
        """Tell the feeder something; safe to call from any thread, does nothing once closed."""
        with self._lock:
            if not self._commands.closed:
                self._commands.send_multipart([kind, messages.pack(values)])

    def remove_directory(self) -> None:
        """Take the directory away; what is left when everything must end at once."""
        shutil.rmtree(self.directory, ignore_errors=True)

    def close(self) -> None:
        """Close the sockets and take the directory away."""
        with self._lock:
            self._context.destroy(linger=0)
        self.remove_directory()


def _short_directory() -> Path:
    """A private directory whose sockets have paths that fit, in TMPDIR, or where that is too long, /tmp."""
    for parent in (None, "/tmp"):
        directory = Path(tempfile.mkdtemp(prefix="chachart-", dir=parent))
        if len(os.fsencode(directory)) + LONGEST_NAME <= LONGEST_PATH:
            return directory
        directory.rmdir()
    raise SetupError(
        f"no directory for Unix sockets: {tempfile.gettempdir()} is too long, set TMPDIR to another"
    )
