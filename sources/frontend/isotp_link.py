"""ISO-TP on a CAN bus by can-isotp: many packets in per bus, one front-end an identifier."""

from __future__ import annotations

import logging
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

import isotp

from chachart.node.data.counters import Counters
from chachart.sources.frontend.address import FrontEndAddress

if TYPE_CHECKING:
    import can

RX_TIMEOUT_MS = 10_000
"""A packet that stopped halfway is given up when the next one begins, or after this long."""


LOGGER = "chachart.isotp"
# can-isotp warns of every single error; they are counted instead.
logging.getLogger(LOGGER).setLevel(logging.CRITICAL)


CONSECUTIVE_MS = 5000
"""How long a packet that has begun may stand still: ISO 15765-2 says 1 s, a busy host may take longer."""


def make_layer(
    receive: Callable[[float], isotp.CanMessage | None],
    send: Callable[[isotp.CanMessage], None],
    tx_id: int,
    rx_id: int,
    extended: bool,
    on_error: Callable[[Exception], None],
    **parameters: Any,
) -> isotp.TransportLayerLogic:
    """An ISO-TP end that sends on `tx_id` and hears `rx_id`; the receiver never holds the sender up."""
    mode = isotp.AddressingMode.Normal_29bits if extended else isotp.AddressingMode.Normal_11bits
    return isotp.TransportLayerLogic(
        rxfn=receive,
        txfn=send,
        address=isotp.Address(mode, txid=tx_id, rxid=rx_id),
        error_handler=on_error,
        params={
            "blocksize": 0,
            "stmin": 0,
            "rx_consecutive_frame_timeout": CONSECUTIVE_MS,
            "logger_name": LOGGER,
            **parameters,
        },
    )


class IsoTpReceiver:
    """CAN messages in, the packets they carry out, for the front-ends at some addresses.

    Parameters
    ----------
    addresses
        Who is listened to; other identifiers are ignored.
    max_packet_bytes
        Longest packet; a longer one is refused when it is announced, before memory is taken for it.
    rejected
        Where damage is counted: `isotp_` and the kind of error.
    send
        Sends a flow control message; None to listen only (a log file).
    fd
        Whether flow control goes out as CAN FD.
    """

    def __init__(
        self,
        addresses: tuple[FrontEndAddress, ...],
        max_packet_bytes: int,
        rejected: Counters,
        send: Callable[[isotp.CanMessage], None] | None,
        fd: bool,
    ) -> None:
        self._rejected = rejected
        self._ends = {a.id: _End(a, max_packet_bytes, self._count, send, fd) for a in addresses}

    def feed(self, messages: Iterable[can.Message]) -> list[tuple[str, bytearray]]:
        """The packets that CAN messages complete, each with the name of its front-end."""
        for message in messages:
            if message.is_error_frame or message.is_remote_frame:
                self._rejected.add("can_error_frame" if message.is_error_frame else "can_remote_frame")
            elif (end := self._ends.get(message.arbitration_id)) is not None:
                end.waiting.append(
                    isotp.CanMessage(
                        arbitration_id=message.arbitration_id,
                        data=bytes(message.data),
                        extended_id=message.is_extended_id,
                        is_fd=message.is_fd,
                    )
                )
        return [(end.name, packet) for end in self._ends.values() for packet in end.packets()]

    def _count(self, error: Exception) -> None:
        words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", type(error).__name__.removesuffix("Error"))
        self._rejected.add(f"isotp_{words.lower()}")


class _End:
    """The node's end of the line to one front-end."""

    def __init__(
        self,
        address: FrontEndAddress,
        max_packet_bytes: int,
        on_error: Callable[[Exception], None],
        send: Callable[[isotp.CanMessage], None] | None,
        fd: bool,
    ) -> None:
        self.name = address.name
        self.waiting: deque[isotp.CanMessage] = deque()
        self.layer = make_layer(
            lambda timeout: self.waiting.popleft() if self.waiting else None,
            send or (lambda message: None),
            address.reply_id,
            address.id,
            address.extended,
            on_error,
            max_frame_size=max_packet_bytes,
            can_fd=fd,
            listen_mode=send is None,
            rx_consecutive_frame_timeout=RX_TIMEOUT_MS,
        )

    def packets(self) -> Iterator[bytearray]:
        """The packets that the waiting messages complete."""
        while self.waiting:
            self.layer.process()
        while (packet := self.layer.recv()) is not None:
            yield packet
