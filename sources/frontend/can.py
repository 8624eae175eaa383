"""The source `can`: front-ends on a CAN or CAN FD bus, any interface of python-can."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field, field_validator

from chachart.node.data.extras import missing
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import SourceSettings
from chachart.sources.frontend.address import FrontEndAddress, distinct
from chachart.sources.frontend.can_bus import CanBusSettings, open_bus
from chachart.sources.frontend.device import Link
from chachart.sources.frontend.live import LinkLost, LiveSettings, LiveSource, Packets
from chachart.sources.frontend.packet import max_packet_bytes

if TYPE_CHECKING:
    import can
    import isotp

    from chachart.sources.frontend.isotp_link import IsoTpReceiver

MAX_MESSAGES = 64
"""CAN messages taken at once: can-isotp handles several at half the price of one by one."""


class CanSettings(LiveSettings, CanBusSettings):
    """Array front-ends on a CAN bus, sending packets of sources/frontend/PACKET.md over ISO-TP."""

    type: Literal["can"] = "can"
    """Which source."""
    front_ends: tuple[FrontEndAddress, ...] = Field((FrontEndAddress(),), min_length=1)
    """Who is listened to; each sends whole frames of the array. A loopback is the first of them."""

    @field_validator("front_ends")
    @classmethod
    def _distinct(cls, value: tuple[FrontEndAddress, ...]) -> tuple[FrontEndAddress, ...]:
        return distinct(value)


class CanSource(LiveSource):
    """Live frames from the front-ends on one bus."""

    Settings: ClassVar[type[SourceSettings]] = CanSettings
    extra = "can"
    settings: CanSettings

    def __init__(self, settings: CanSettings, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._bus: can.BusABC | None = None
        self._receiver: IsoTpReceiver | None = None

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

    @property
    def where(self) -> str:
        """Interface and channel."""
        return f"{self.settings.interface}:{self.settings.channel}"

    def _far_end(self) -> Link:
        from chachart.sources.frontend.can_link import CanLink

        return CanLink(self.settings, self.settings.front_ends[0])

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

    def _packets(self, timeout: float) -> Packets | None:
        import can

        assert self._bus is not None
        assert self._receiver is not None
        try:
            message = self._bus.recv(timeout)
            if message is None:
                return None
            messages = [message]
            while len(messages) < MAX_MESSAGES and (message := self._bus.recv(0.0)) is not None:
                messages.append(message)
            return self._receiver.feed(messages)
        except (can.CanError, OSError) as error:
            raise LinkLost(str(error)) from None

    def _hang_up(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def _reply(self, message: isotp.CanMessage) -> None:
        import can

        assert self._bus is not None
        self._bus.send(
            can.Message(
                arbitration_id=message.arbitration_id,
                data=message.data,
                is_extended_id=message.is_extended_id,
                is_fd=message.is_fd,
            )
        )
