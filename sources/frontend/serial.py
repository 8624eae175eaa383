"""The source `serial`: a front-end on a serial port, or a simulated one on a pseudo-terminal."""

from __future__ import annotations

import os
import select
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from chachart.node.data.errors import SetupError
from chachart.node.data.extras import missing
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import SourceSettings
from chachart.sources.frontend.device import Link
from chachart.sources.frontend.live import LinkLost, LiveSettings, LiveSource, Packets
from chachart.sources.frontend.packet import max_packet_bytes

if TYPE_CHECKING:
    import serial

    from chachart.sources.frontend.framing import StreamDecoder
    from chachart.sources.frontend.serial_link import PtyLink

MAX_READ_BYTES = 1 << 20


class SerialSettings(LiveSettings):
    """An array front-end on a serial port, sending packets of sources/frontend/PACKET.md in COBS."""

    type: Literal["serial"] = "serial"
    """Which source."""
    port: str = Field("/dev/ttyUSB0", min_length=1)
    """The port: a device, or socket://HOST:PORT for a serial server. A loopback has its own."""
    baudrate: int = Field(921_600, ge=1)
    """Bits per second; a USB CDC device ignores it."""


class SerialSource(LiveSource):
    """Live frames from one front-end on a serial port, which is opened for this node alone."""

    Settings: ClassVar[type[SourceSettings]] = SerialSettings
    extra = "serial"
    settings: SerialSettings

    def __init__(self, settings: SerialSettings, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._decoder: StreamDecoder | None = None
        self._serial: serial.Serial | None = None
        self._pty: PtyLink | None = None

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

    @property
    def where(self) -> str:
        """The port."""
        return "loopback" if self.settings.loopback else self.settings.port

    def _far_end(self) -> Link:
        from chachart.sources.frontend.serial_link import PtyLink

        self._pty = PtyLink()
        return self._pty

    def _connect(self) -> None:
        import serial

        from chachart.sources.frontend.framing import StreamDecoder

        port = self.settings.port if self._pty is None else self._pty.where
        longest = max_packet_bytes(self.array.antennas, self.array.subcarriers)
        self._decoder = StreamDecoder(longest, self.rejected)
        try:
            self._serial = serial.serial_for_url(
                port, baudrate=self.settings.baudrate, timeout=0, exclusive=True
            )
            self._serial.fileno()  # raises where there is nothing to wait for
        except (serial.SerialException, OSError, ValueError) as error:
            self._hang_up()
            raise SetupError(f'[source] serial port "{port}" cannot be opened: {error}') from None

    def _packets(self, timeout: float) -> Packets | None:
        import serial

        assert self._serial is not None
        assert self._decoder is not None
        try:
            # Changing pyserial's own timeout makes it set up the port again: wait here instead.
            if not select.select([self._serial], [], [], timeout)[0]:
                return None
            data = self._serial.read(MAX_READ_BYTES)
        except (serial.SerialException, OSError) as error:
            raise LinkLost(str(error)) from None
        return [(self.where, packet) for packet in self._decoder.feed(data)]

    def _hang_up(self) -> None:
        if self._serial is not None:
            self._serial.close()
            self._serial = None
