"""The device's end of a serial line: a real port, or a pseudo-terminal that a node can open like one."""

from __future__ import annotations

import fcntl
import os
import select
import struct
import termios
import time
import tty
from pathlib import Path

import numpy as np

from chachart.node.data.errors import SetupError
from chachart.sources.frontend.device import Link, damaged
from chachart.sources.frontend.framing import encode_frame

PATIENCE_S = 1.0
"""A reader that has taken nothing for so long takes nothing more."""


class PtyLink(Link):
    """A pseudo-terminal. It knows when somebody opens its other end, and waits while that end is full.

    Parameters
    ----------
    symlink
        A name for the other end that stays the same when it is unplugged and plugged in again.

    Raises
    ------
    SetupError
        If `symlink` is there already and is no symbolic link, or cannot be made.
    """

    def __init__(self, symlink: Path | None = None) -> None:
        super().__init__()
        self._symlink = symlink
        self._master = -1
        self._terminal = ""
        self._listening = False
        self.plug()

    @property
    def where(self) -> str:
        """What the node opens; empty while it is unplugged and has no name of its own."""
        return str(self._symlink or self._terminal)

    def plug(self) -> None:
        """Make a terminal, and give it its name."""
        self._master, other = os.openpty()
        tty.setraw(other)
        self._terminal = os.ttyname(other)
        # In packet mode the master is told when the other end flushes its input, which pyserial does last
        # when it opens a port: what is sent from then on is not lost.
        fcntl.ioctl(self._master, termios.TIOCPKT, struct.pack("i", 1))
        os.set_blocking(self._master, False)
        os.close(other)
        if self._symlink is not None:
            try:
                if self._symlink.is_symlink():
                    self._symlink.unlink()
                self._symlink.symlink_to(self._terminal)
            except OSError as error:
                os.close(self._master)
                self._master = -1
                raise SetupError(f"cannot make the link {self._symlink}: {error.strerror}") from None

    def wait_ready(self, timeout: float) -> bool:
        """Whether the other end is open."""
        deadline = time.monotonic() + timeout
        while self._master >= 0 and not self.stopping.is_set():
            events = self._poll(select.POLLIN, 0.0)
            if events & select.POLLIN:
                self._take_notice()
            if events & select.POLLHUP:
                self._listening = False
            if self._listening or time.monotonic() >= deadline:
                return self._listening
            self.stopping.wait(0.005)
        return False

    def send(self, packet: bytes, damage: np.random.Generator | None = None) -> bool:
        """Write the packet in its frame, waiting while the other end is full."""
        if not self._listening:
            return False
        wire = encode_frame(packet)
        left = memoryview(wire if damage is None else damaged(wire, damage))
        while left:
            try:
                left = left[os.write(self._master, left) :]
            except BlockingIOError:
                if self.stopping.is_set() or self._poll(select.POLLOUT, 0.1) & select.POLLHUP:
                    return False
            except OSError:
                return False
        return True

    def unplug(self) -> None:
        """Wait until the other end has read everything, or reads no more, then hang up."""
        if self._master < 0:
            return
        unread, empty, deadline = -1, 0, time.monotonic() + PATIENCE_S
        while self._listening and empty < 3 and time.monotonic() < deadline:
            before, unread = unread, self._unread()
            empty = 0 if unread else empty + 1
            if unread != before:
                deadline = time.monotonic() + PATIENCE_S
            time.sleep(0.01)
        os.close(self._master)
        self._master, self._terminal, self._listening = -1, "", False
        if self._symlink is not None:
            self._symlink.unlink(missing_ok=True)

    def close(self) -> None:
        """Hang up at once."""
        self._listening = False
        self.unplug()

    def _take_notice(self) -> None:
        flags = os.read(self._master, 4096)[0]
        if flags & termios.TIOCPKT_FLUSHREAD:
            self._listening = True
            self.connections += 1

    def _poll(self, events: int, timeout: float) -> int:
        poller = select.poll()
        poller.register(self._master, events)
        ready = poller.poll(timeout * 1e3)
        return ready[0][1] if ready else 0

    def _unread(self) -> int:
        other = os.open(self._terminal, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            raw: bytes = fcntl.ioctl(other, termios.FIONREAD, struct.pack("i", 0))
        finally:
            os.close(other)
        unread: int = struct.unpack("i", raw)[0]
        return unread


class PortLink(Link):
    """A serial port, for testing a node through real cables.

    Raises
    ------
    SetupError
        If the port cannot be opened.
    """

    def __init__(self, port: str, baudrate: int) -> None:
        super().__init__()
        import serial

        self._port = port
        try:
            self._serial = serial.Serial(port, baudrate, write_timeout=1.0)
        except (serial.SerialException, OSError, ValueError) as error:
            raise SetupError(f'serial port "{port}" cannot be opened: {error}') from None
        self.connections = 1

    @property
    def where(self) -> str:
        """The port at this end."""
        return self._port

    def wait_ready(self, timeout: float) -> bool:
        """A cable does not tell whether somebody listens."""
        return self._serial.is_open

    def send(self, packet: bytes, damage: np.random.Generator | None = None) -> bool:
        """Write the packet in its frame."""
        import serial

        wire = encode_frame(packet)
        try:
            self._serial.write(wire if damage is None else damaged(wire, damage))
        except (serial.SerialException, OSError):
            return False
        return True

    def unplug(self) -> None:
        """Send what is left, and close the port."""
        if self._serial.is_open:
            self._serial.flush()
            self._serial.close()

    def plug(self) -> None:
        """Open the port again."""
        self._serial.open()
        self.connections += 1

    def close(self) -> None:
        """Close the port."""
        self._serial.close()
