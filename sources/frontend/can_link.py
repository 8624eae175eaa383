"""The device's end of a CAN bus."""

from __future__ import annotations

import can
import isotp
import numpy as np

from chachart.sources.frontend.address import FrontEndAddress
from chachart.sources.frontend.can_bus import CanBusSettings, open_bus
from chachart.sources.frontend.device import Link
from chachart.sources.frontend.isotp_link import make_layer

FLOW_CONTROL_MS = 15_000
"""How long the device waits for the node to say go on, on a busy host too ..."""
DAMAGED_FLOW_CONTROL_MS = 50
"""... and how long where it has spoiled the packet itself."""


class CanLink(Link):
    """A front-end's place on a bus.

    Parameters
    ----------
    settings, address
        The bus, and who the front-end is on it.

    Raises
    ------
    SetupError
        If the bus cannot be opened.
    """

    def __init__(self, settings: CanBusSettings, address: FrontEndAddress) -> None:
        super().__init__()
        self._settings = settings
        self._address = address
        self._bus: can.BusABC | None = None
        self._success = False
        self._damage: np.random.Generator | None = None
        self._segment = self._hit = 0
        self.plug()

    @property
    def where(self) -> str:
        """The bus."""
        return f"{self._settings.interface}:{self._settings.channel}"

    def plug(self) -> None:
        """Open the bus."""
        fd = self._settings.fd
        self._bus = open_bus(self._settings, [self._address.reply_id])
        self._layer = make_layer(
            self._receive,
            self._transmit,
            self._address.id,
            self._address.reply_id,
            self._address.extended,
            lambda error: None,
            can_fd=fd,
            bitrate_switch=fd,
            tx_data_length=64 if fd else 8,
            rx_flowcontrol_timeout=FLOW_CONTROL_MS,
        )
        self._layer.post_send_callback = self._remember
        self.connections += 1

    def wait_ready(self, timeout: float) -> bool:
        """A bus does not tell who listens."""
        return self._bus is not None

    def send(self, packet: bytes, damage: np.random.Generator | None = None) -> bool:
        """Send a packet as one ISO-TP message; False if the node does not take it.

        A packet that the node refuses is sent once more: the refusal may have been meant for the one before.
        """
        if self._bus is None:
            return False
        if damage is None:
            return self._attempt(packet, FLOW_CONTROL_MS) or self._attempt(packet, FLOW_CONTROL_MS)
        self._damage = damage
        self._hit = int(damage.integers(segments(len(packet), self._settings.fd)))
        self._attempt(packet, DAMAGED_FLOW_CONTROL_MS)
        self._damage = None
        return True

    def unplug(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def close(self) -> None:
        """Leave the bus."""
        self.unplug()

    def _attempt(self, packet: bytes, patience_ms: int) -> bool:
        self._segment = 0
        self._layer.params.rx_flowcontrol_timeout = patience_ms
        self._layer.send(packet)
        try:
            while self._layer.transmitting() and not self.stopping.is_set():
                self._layer.process(0.05)
        except (can.CanError, OSError):
            self._layer.stop_sending()
        return self._request.success

    def _remember(self, request: isotp.TransportLayerLogic.SendRequest) -> None:
        self._request = request

    def _receive(self, timeout: float) -> isotp.CanMessage | None:
        assert self._bus is not None
        message = self._bus.recv(timeout)
        if message is None or message.is_error_frame:
            return None
        return isotp.CanMessage(
            arbitration_id=message.arbitration_id,
            data=bytes(message.data),
            extended_id=message.is_extended_id,
            is_fd=message.is_fd,
        )

    def _transmit(self, message: isotp.CanMessage) -> None:
        segment, self._segment = self._segment, self._segment + 1
        if self._damage is None or segment != self._hit:
            self._put(message, message.data)
            return
        kind = self._damage.integers(3)
        if kind == 0:
            data = bytearray(message.data)
            data[self._damage.integers(2)] ^= int(self._damage.integers(1, 256))
            self._put(message, data)
        elif kind == 1 and segment > 0:
            # One message too many, and not the one that comes next.
            self._put(
                message, bytes([message.data[0] & 0xF0 | (message.data[0] + 5) & 0x0F]) + message.data[1:]
            )
            self._put(message, message.data)

    def _put(self, message: isotp.CanMessage, data: bytes | bytearray) -> None:
        assert self._bus is not None
        self._bus.send(
            can.Message(
                arbitration_id=message.arbitration_id,
                data=data,
                is_extended_id=message.is_extended_id,
                is_fd=message.is_fd,
                bitrate_switch=message.bitrate_switch,
            ),
            timeout=1.0,
        )


def segments(length: int, fd: bool) -> int:
    """CAN messages that a packet of `length` bytes takes."""
    size = 64 if fd else 8
    if length <= (size - 2 if fd else 7):
        return 1
    first = size - 2 if length <= 0xFFF else size - 6
    return 1 + -(-(length - first) // (size - 1))
