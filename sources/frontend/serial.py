"""The source `serial`: a front-end on a serial port, or a simulated one on a pseudo-terminal."""

from __future__ import annotations

import logging
import os
import select
import time
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from chachart.node.csi import CsiBlock
from chachart.node.errors import SetupError
from chachart.node.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.frontend.drivers import missing, require
from chachart.sources.frontend.loopback import Loopback, LoopbackSettings, loopback_settings
from chachart.sources.frontend.packet import max_packet_bytes
from chachart.sources.frontend.retry import Backoff
from chachart.sources.frontend.session import Intake

if TYPE_CHECKING:
    import serial

    from chachart.sources.frontend.framing import StreamDecoder
    from chachart.sources.frontend.serial_link import PtyLink

log = logging.getLogger(__name__)

MAX_READ_BYTES = 1 << 20


class SerialSettings(SourceSettings):
    """An array front-end on a serial port, sending packets of sources/frontend/PACKET.md in COBS."""

    type: Literal["serial"] = "serial"
    """Which source."""
    port: str = Field("/dev/ttyUSB0", min_length=1)
    """The port: a device, or socket://HOST:PORT for a serial server."""
    baudrate: int = Field(921_600, ge=1)
    """Bits per second; a USB CDC device ignores it."""
    retry_max_s: float = Field(5.0, gt=0)
    """Longest wait between two tries to open a port that has gone; the first is 0.1 s."""
    loopback: LoopbackSettings | bool = False
    """true, or a table: simulate a front-end in this process, on a pseudo-terminal instead of `port`.
    Its keys: `format` (int8, int16 or float32), `corrupt`, `drop`, `reorder` (fractions of the frames),
    `unplug_every_s`, `unplugged_s`, `serial_number`, `fault_seed`, and `scenario`, a simulator's settings."""


class SerialSource(Source):
    """Live frames from one front-end. Unplugging is survived: the port is tried again until it is back."""

    Settings: ClassVar[type[SourceSettings]] = SerialSettings
    settings: SerialSettings

    def __init__(self, settings: SerialSettings, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._intake = Intake(array, self.rejected)
        self._backoff = Backoff(settings.retry_max_s)
        self._decoder: StreamDecoder | None = None
        self._serial: serial.Serial | None = None
        self._loopback: Loopback | None = None
        self._name = "loopback" if settings.loopback else settings.port
        self._pty: PtyLink | None = None
        self._reconnects = 0
        self._bytes = 0

    @classmethod
    def problems(cls, settings: SerialSettings) -> list[str]:
        """A missing driver, a port that does not exist or may not be opened."""
        if problems := missing("serial"):
            return problems
        port = settings.port
        if settings.loopback or "://" in port:
            return []
        if not os.path.exists(port):
            return [f"port = {port!r}: there is no such device"]
        if not os.access(port, os.R_OK | os.W_OK):
            return [f"port = {port!r}: may not be read and written by this user (group dialout?)"]
        return []

    def open(self) -> None:
        """Open the port, and put a simulated front-end at its other end where `loopback` is set.

        Raises
        ------
        SetupError
            If the port cannot be opened, or pyserial or cobs are not installed.
        """
        require("serial")
        import serial

        from chachart.sources.frontend.framing import StreamDecoder

        self._decoder = StreamDecoder(
            max_packet_bytes(self.array.antennas, self.array.subcarriers), self.rejected
        )
        if (simulated := loopback_settings(self.settings.loopback)) is not None:
            from chachart.sources.frontend.serial_link import PtyLink

            self._pty = PtyLink()
            self._loopback = Loopback(simulated, self.array, self._pty)
        try:
            self._connect()
        except (serial.SerialException, OSError, ValueError) as error:
            self.close()
            raise SetupError(f'[source] serial port "{self._port}" cannot be opened: {error}') from None
        if self._loopback is not None:
            self._loopback.start()

    def recv(self, timeout: float) -> CsiBlock | None:
        """The frames that have come, as a block, or None if none came within `timeout` seconds.

        Raises
        ------
        EndOfSource
            When a simulated front-end has sent all its frames.
        """
        deadline = time.monotonic() + timeout
        while True:
            self._read(max(deadline - time.monotonic(), 0.0))
            if len(self._intake) or time.monotonic() >= deadline:
                break
        if not len(self._intake) and self._loopback is not None and self._loopback.finished():
            raise EndOfSource
        return self._intake.take()

    def close(self) -> None:
        """Close the port."""
        if self._loopback is not None:
            self._loopback.stop()
            self._loopback = None
        if self._serial is not None:
            self._serial.close()
            self._serial = None

    def details(self) -> dict[str, Any]:
        """Port, whether it is open, how often it was opened again, and the front-end behind it."""
        return {
            "port": self._port,
            "connected": self._serial is not None,
            "reconnects": self._reconnects,
            "bytes": self._bytes,
            **self._intake.details(),
        }

    @property
    def _port(self) -> str:
        return self.settings.port if self._pty is None else self._pty.where

    def _connect(self) -> None:
        import serial

        self._serial = serial.serial_for_url(
            self._port, baudrate=self.settings.baudrate, timeout=0, exclusive=True
        )
        self._serial.fileno()  # raises where there is nothing to wait for

    def _read(self, timeout: float) -> None:
        """Wait for bytes, or for the next try to open the port; at most `timeout` seconds."""
        import serial

        if self._serial is None:
            self._reconnect(timeout)
            return
        try:
            # Changing pyserial's own timeout makes it set up the port again: wait here instead.
            if not select.select([self._serial], [], [], timeout)[0]:
                return
            data = self._serial.read(MAX_READ_BYTES)
        except (serial.SerialException, OSError) as error:
            self._disconnected(str(error))
            return
        assert self._decoder is not None
        self._bytes += len(data)
        host_ns = time.time_ns()
        for packet in self._decoder.feed(data):
            self._intake.receive(self._name, packet, host_ns)

    def _disconnected(self, why: str) -> None:
        log.warning("serial port %s has gone (%s): trying again until it is back", self._name, why)
        assert self._serial is not None
        assert self._decoder is not None
        self._serial.close()
        self._serial = None
        self._decoder.reset()
        self._backoff.failed()

    def _reconnect(self, timeout: float) -> None:
        import serial

        wait = self._backoff.wait_s()
        if wait > 0:
            time.sleep(min(wait, timeout))
            return
        try:
            self._connect()
        except (serial.SerialException, OSError) as error:
            log.debug("serial port %s: %s", self._name, error)
            self._backoff.failed()
            return
        self._backoff.succeeded()
        self._reconnects += 1
        log.info("serial port %s is back", self._name)
