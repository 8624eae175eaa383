"""Opening a CAN bus of python-can, and saying clearly why it cannot be opened."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field

from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.sources.base import SourceSettings

if TYPE_CHECKING:
    import can


class CanBusSettings(SourceSettings):
    """Which bus."""

    interface: str = Field("socketcan", min_length=1)
    """Interface of python-can: socketcan, pcan, kvaser, vector, slcan, udp_multicast, virtual, ..."""
    channel: str = Field("can0", min_length=1)
    """Channel of that interface."""
    fd: bool = True
    """CAN FD: up to 64 bytes a message instead of 8."""
    bitrate: int | None = Field(None, ge=1)
    """Bits per second of the arbitration phase, where the interface sets it."""
    data_bitrate: int | None = Field(None, ge=1)
    """Bits per second of the data phase (CAN FD), where the interface sets it."""
    options: dict[str, bool | int | float | str] = Field(default_factory=dict)
    """Anything else python-can's interface takes."""


def open_bus(settings: CanBusSettings, listen_to: list[int]) -> can.BusABC:
    """The bus, filtered to the identifiers in `listen_to`.

    Raises
    ------
    SetupError
        If it cannot be opened.
    """
    require("can", "[source]")
    import can

    options: dict[str, Any] = {"fd": settings.fd, **settings.options}
    for key in ("bitrate", "data_bitrate"):
        if (value := getattr(settings, key)) is not None:
            options[key] = value
    try:
        bus = can.Bus(settings.channel, settings.interface, ignore_config=True, **options)
    except (can.CanError, OSError, ValueError, TypeError, NotImplementedError, ImportError) as error:
        raise SetupError(
            f'[source] CAN channel "{settings.channel}" of interface "{settings.interface}" '
            f"cannot be opened: {error or type(error).__name__}"
        ) from None
    bus.set_filters(
        [
            {"can_id": i, "can_mask": 0x1FFFFFFF if i > 0x7FF else 0x7FF, "extended": i > 0x7FF}
            for i in listen_to
        ]
    )
    return bus
