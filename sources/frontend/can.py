"""The source `can`: front-ends on a CAN or CAN FD bus, any interface of python-can."""

from __future__ import annotations

import logging
import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field, field_validator

from chachart.node.csi import CsiBlock
from chachart.node.errors import SetupError
from chachart.node.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.frontend.address import FrontEndAddress, distinct
from chachart.sources.frontend.can_bus import CanBusSettings, open_bus
from chachart.sources.frontend.drivers import missing, require
from chachart.sources.frontend.loopback import Loopback, LoopbackSettings, loopback_settings
from chachart.sources.frontend.packet import max_packet_bytes
from chachart.sources.frontend.retry import Backoff
from chachart.sources.frontend.session import Intake

if TYPE_CHECKING:
    import can
    import isotp

    from chachart.sources.frontend.isotp_link import IsoTpReceiver

log = logging.getLogger(__name__)

MAX_BLOCK_FRAMES = 64
MAX_MESSAGES = 64
"""CAN messages taken at once: can-isotp handles several at half the price of one by one."""


class CanSettings(CanBusSettings):
    """Array front-ends on a CAN bus, sending packets of sources/frontend/PACKET.md over ISO-TP."""

    type: Literal["can"] = "can"
    """Which source."""
    front_ends: tuple[FrontEndAddress, ...] = Field((FrontEndAddress(),), min_length=1)
    """Who is listened to; each sends whole frames of the array, of its own UEs or in turn."""
    retry_max_s: float = Field(5.0, gt=0)
    """Longest wait between two tries to open a bus that has gone; the first is 0.1 s."""
    loopback: LoopbackSettings | bool = False
    """true, or a table: simulate the first front-end in this process, on the same bus.
    Its keys: `format` (int8, int16 or float32), `corrupt`, `drop`, `reorder` (fractions of the frames),
    `unplug_every_s`, `unplugged_s`, `serial_number`, `fault_seed`, and `scenario`, a simulator's settings."""

    @field_validator("front_ends")
    @classmethod
    def _distinct(cls, value: tuple[FrontEndAddress, ...]) -> tuple[FrontEndAddress, ...]:
        return distinct(value)


class CanSource(Source):
    """Live frames from the front-ends on one bus. A bus that goes is tried again until it is back."""

    Settings: ClassVar[type[SourceSettings]] = CanSettings
    settings: CanSettings

    def __init__(self, settings: CanSettings, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._intake = Intake(array, self.rejected)
        self._backoff = Backoff(settings.retry_max_s)
        self._bus: can.BusABC | None = None
        self._receiver: IsoTpReceiver | None = None
        self._loopback: Loopback | None = None
        self._reconnects = 0
        self._messages = 0

    @classmethod
    def problems(cls, settings: CanSettings) -> list[str]:
        """A missing driver, or an interface that python-can does not have."""
        if problems := missing("can"):
            return problems
        import can

        if settings.interface not in can.VALID_INTERFACES:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            return [f'interface = "{settings.interface}": python-can has only {known}']
        return []

    def open(self) -> None:
        """Open the bus, and put a simulated front-end on it where `loopback` is set.

        Raises
        ------
        SetupError
            If the bus cannot be opened, or python-can or can-isotp are not installed.
        """
        require("can")
        self._connect()
        if (simulated := loopback_settings(self.settings.loopback)) is not None:
            from chachart.sources.frontend.can_link import CanLink

            link = CanLink(self.settings, self.settings.front_ends[0])
            self._loopback = Loopback(simulated, self.array, link)
            self._loopback.start()

    def recv(self, timeout: float) -> CsiBlock | None:
        """The frames that have come, as a block, or None if none came within `timeout` seconds.

        Raises
        ------
        EndOfSource
            When a simulated front-end has sent all its frames.
        """
        deadline = time.monotonic() + timeout
        while len(self._intake) < MAX_BLOCK_FRAMES:
            left = 0.0 if len(self._intake) else max(deadline - time.monotonic(), 0.0)
            if not self._read(left) and (len(self._intake) or time.monotonic() >= deadline):
                break
        if not len(self._intake) and self._loopback is not None and self._loopback.finished():
            raise EndOfSource
        return self._intake.take()

    def close(self) -> None:
        """Leave the bus."""
        if self._loopback is not None:
            self._loopback.stop()
            self._loopback = None
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def details(self) -> dict[str, Any]:
        """Channel, whether it is open, how often it was opened again, and the front-ends on it."""
        return {
            "channel": f"{self.settings.interface}:{self.settings.channel}",
            "connected": self._bus is not None,
            "reconnects": self._reconnects,
            "messages": self._messages,
            **self._intake.details(),
        }

    def simulated(self) -> dict[str, int]:
        """What the simulated front-end says has become of its frames; nothing where there is none."""
        return {} if self._loopback is None else asdict(self._loopback.report)

    def _connect(self) -> None:
        from chachart.sources.frontend.isotp_link import IsoTpReceiver

        self._bus = open_bus(self.settings, [f.id for f in self.settings.front_ends])
        self._receiver = IsoTpReceiver(
            self.settings.front_ends,
            max_packet_bytes(self.array.antennas, self.array.subcarriers),
            self.rejected,
            self._reply,
            self.settings.fd,
        )

    def _reply(self, message: isotp.CanMessage) -> None:
        import can

        if self._bus is not None:
            self._bus.send(
                can.Message(
                    arbitration_id=message.arbitration_id,
                    data=message.data,
                    is_extended_id=message.is_extended_id,
                    is_fd=message.is_fd,
                )
            )

    def _read(self, timeout: float) -> bool:
        """Take the messages that are there, or try to open the bus again; whether any came."""
        import can

        if self._bus is None or self._receiver is None:
            self._reconnect(timeout)
            return False
        try:
            messages = [message] if (message := self._bus.recv(timeout)) is not None else []
            while messages and len(messages) < MAX_MESSAGES and (message := self._bus.recv(0.0)) is not None:
                messages.append(message)
            packets = self._receiver.feed(messages)
        except (can.CanError, OSError) as error:
            self._disconnected(error)
            return False
        self._messages += len(messages)
        host_ns = time.time_ns()
        for name, packet in packets:
            self._intake.receive(name, packet, host_ns)
        return bool(messages)

    def _disconnected(self, why: Exception) -> None:
        where = f"{self.settings.interface}:{self.settings.channel}"
        log.warning("CAN bus %s has gone (%s): trying again until it is back", where, why)
        assert self._bus is not None
        self._bus.shutdown()
        self._bus = None
        self._backoff.failed()

    def _reconnect(self, timeout: float) -> None:
        wait = self._backoff.wait_s()
        if wait > 0:
            time.sleep(min(wait, timeout))
            return
        try:
            self._connect()
        except SetupError as error:
            log.debug("%s", error)
            self._backoff.failed()
            return
        self._backoff.succeeded()
        self._reconnects += 1
        log.info("CAN bus %s:%s is back", self.settings.interface, self.settings.channel)
