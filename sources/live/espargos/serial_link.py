"""The way to an ESPARGOS controller over a serial line."""

from __future__ import annotations

import select
import time
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING

from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.sources.live.device import CodecError, DeviceGone
from chachart.sources.live.espargos import uart
from chachart.sources.live.espargos.link import TIMEOUT_S, Link
from chachart.sources.live.espargos.uart import Kind, UartFrame

if TYPE_CHECKING:
    import serial

    from chachart.sources.frontend.framing import StreamDecoder

HELLO_S = 1.0
SLOW_BAUDRATE = 115_200
READ_BYTES = 1 << 16


class SerialLink(Link):
    """Frames on a serial line.

    Parameters
    ----------
    port, baudrate
        The line.
    rejected
        Where damaged frames are counted.
    """

    def __init__(self, port: str, baudrate: int, rejected: Counters) -> None:
        super().__init__(port)
        self._baudrate, self._rejected = baudrate, rejected
        self._serial: serial.Serial | None = None
        self._decoder: StreamDecoder | None = None
        self._sensor: deque[bytes] = deque()
        self._number = 0
        self._greeted = False

    def begin(self) -> None:
        """See `Link`."""
        self._control(uart.SENSOR_DATA, on=True)

    def fileno(self) -> int:
        """See `Link`."""
        assert self._serial is not None
        return int(self._serial.fileno())

    def packets(self) -> list[bytes]:
        """See `Link`."""
        self._read()
        packets = list(self._sensor)
        self._sensor.clear()
        return packets

    def keep_alive(self) -> None:
        """See `Link`."""
        self._control(uart.KEEP_ALIVE, on=True)

    def close(self) -> None:
        """See `Link`."""
        if self._serial is None:
            return
        with suppress(DeviceGone):  # it may have gone: nothing is left to stop
            self._control(uart.SENSOR_DATA, on=False)
        self._serial.close()
        self._serial = None

    def ask(self, method: str, path: str, body: str = "") -> tuple[int, str]:
        """See `Controller`."""
        try:
            if self._serial is None:
                self._open()
            answer = self._exchange(Kind.REQUEST, Kind.RESPONSE, uart.request(method, path, body.encode()))
            return uart.parse_response(answer)
        except (DeviceGone, CodecError) as error:
            raise SetupError(
                f'[source] ESPARGOS controller at "{self.name}" does not answer: {error}'
            ) from None

    def _open(self) -> None:
        """Open the port and be greeted; a controller that is silent is told to speak frames at this rate."""
        require("serial", "[source]")
        import serial

        from chachart.sources.frontend.framing import StreamDecoder

        self._decoder = StreamDecoder(uart.LONGEST_PAYLOAD + 8, self._rejected)
        try:
            self._serial = serial.serial_for_url(
                self.name, baudrate=self._baudrate, timeout=0, exclusive=True
            )
            try:
                self._exchange(Kind.HELLO, Kind.HELLO_RESPONSE, b"", HELLO_S)
            except DeviceGone:
                self._serial.baudrate = SLOW_BAUDRATE
                self._serial.write(b"ESPARGOS-UART-MODE:%d\n" % self._baudrate)
                self._serial.flush()
                time.sleep(0.1)
                self._serial.baudrate = self._baudrate
                time.sleep(0.1)
                self._serial.reset_input_buffer()
                self._exchange(Kind.HELLO, Kind.HELLO_RESPONSE, b"", HELLO_S)
        except (serial.SerialException, OSError, ValueError) as error:
            raise SetupError(f'[source] serial port "{self.name}" cannot be opened: {error}') from None

    def _exchange(self, kind: Kind, wanted: Kind, payload: bytes, within_s: float = TIMEOUT_S) -> bytes:
        """Send a frame and wait for its answer; sensor packets on the way are kept."""
        self._number = (self._number + 1) % 65536
        self._write(UartFrame(kind, self._number, payload))
        deadline = time.monotonic() + within_s
        while (left := deadline - time.monotonic()) > 0:
            if select.select([self.fileno()], [], [], left)[0]:
                for frame in self._read():
                    if frame.kind == wanted and frame.number == self._number:
                        return frame.payload
        raise DeviceGone(f"no answer within {within_s:g} s")

    def _control(self, which: int, *, on: bool) -> None:
        self._number = (self._number + 1) % 65536
        self._write(UartFrame(Kind.STREAM_CONTROL, self._number, bytes([which, on])))

    def _write(self, frame: UartFrame) -> None:
        from cobs import cobs

        assert self._serial is not None
        try:
            self._serial.write(cobs.encode(uart.encode(frame)) + b"\0")
        except OSError as error:
            raise DeviceGone(str(error)) from None

    def _read(self) -> list[UartFrame]:
        """The frames that have come, but for sensor packets, which are kept, and text of the log."""
        assert self._serial is not None
        assert self._decoder is not None
        try:
            data = self._serial.read(READ_BYTES)
        except OSError as error:
            raise DeviceGone(str(error)) from None
        frames = []
        for piece in self._decoder.feed(data):
            try:
                frame = uart.decode(piece)
            except CodecError as error:
                self._rejected.add(error.reason)
                continue
            if frame.kind == Kind.SENSOR_PACKET:
                self._sensor.append(frame.payload)
            elif frame.kind != Kind.LOG:
                frames.append(frame)
        return frames
