"""What the source `espargos` can be told."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from chachart.node.data.geometry import SPEED_OF_LIGHT
from chachart.node.data.settings import Settings
from chachart.sources.live.device import DeviceSettings
from chachart.sources.live.espargos.board import BoardFaults
from chachart.sources.simulator import SimulatorSettings

UDP_PORT = 53330


class EspargosLoopback(BoardFaults):
    """A simulated board in this process: nothing needs to be plugged in."""

    channel_primary: int = Field(13, ge=1, le=14)
    """The Wi-Fi channel that it listens on."""
    scenario: SimulatorSettings = SimulatorSettings(ues=32, frame_rate_hz=200.0, snr_db=20.0)
    """What it hears."""


class Board(Settings):
    """One board of several that are wired to one clock."""

    host: str = Field("192.168.1.2", min_length=1, max_length=253)
    """Its controller's address, with `:port` where that is not 80."""
    serial_port: str | None = Field(None, min_length=1)
    """The serial port that its controller is connected to, instead of a network."""
    baudrate: int = Field(3_000_000, ge=1)
    """Of the serial port: 2000000 behind an FT231X."""
    cable_m: float = Field(0.0, ge=0)
    """Length of the cable that brings it the common reference."""
    velocity_factor: float = Field(0.69, gt=0, le=1)
    """Speed in that cable over that of light."""

    @property
    def cable_s(self) -> float:
        """Delay of that cable."""
        return self.cable_m / (self.velocity_factor * SPEED_OF_LIGHT)


class EspargosSettings(DeviceSettings):
    """ESPARGOS boards over UDP. Phase is random and delay relative: a packet says where, not how far."""

    type: Literal["espargos"] = "espargos"
    """Which source."""
    boards: tuple[Board, ...] = Field((Board(),), min_length=1, max_length=16)
    """One board, or several wired to one clock: their antennas, one board after the other, are one array, or
    those that `array` names."""
    calibrate_s: float = Field(2.0, ge=0, le=60)
    """How long the reference is listened to at the start and after the channel has changed; 0: not at all."""
    udp_port: int = Field(UDP_PORT, ge=1, le=65535)
    """Where the controllers want signs of life."""
    loopback: EspargosLoopback | bool = False
    """true, or a table: simulate the boards in this process. Its keys: `corrupt`, `drop`, `reorder` (parts of
    the packets), `clock_ns`, `fault_seed`, `channel_primary`, and `scenario`, a simulator's settings."""
