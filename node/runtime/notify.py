"""Tells systemd how the node is, where it is a unit of `Type=notify`."""

from __future__ import annotations

import os
import socket
import time
from contextlib import suppress


class Notifier:
    """Sends to NOTIFY_SOCKET; does nothing where there is none."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        every_us = os.environ.get("WATCHDOG_USEC", "")
        self._every_s = int(every_us) / 1e6 / 3 if every_us.isdigit() else None
        self._next = 0.0
        self._last = ""

    def ready(self) -> None:
        """Frames are read."""
        self._send("READY=1")

    def stopping(self) -> None:
        """The node drains."""
        self._send("STOPPING=1")

    def alive(self, words: str) -> None:
        """The node's loop has its turn; `words` say how the node is."""
        now = time.monotonic()
        if self._every_s is not None and now >= self._next:
            self._next = now + self._every_s
            self._send("WATCHDOG=1")
        if words != self._last:
            self._last = words
            self._send(f"STATUS={words}")

    def _send(self, message: str) -> None:
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
            notify.sendto(message.encode(), address)
