"""The source `wifi`: live frames from tools that read CSI from Wi-Fi cards."""

from __future__ import annotations

import time
from typing import ClassVar, Literal

from pydantic import Field

from chachart.node.data.counters import Counters
from chachart.node.data.facts import CaptureFacts
from chachart.node.net.security import SecuritySettings
from chachart.sources.base import SourceSettings
from chachart.sources.live.device import (
    CodecError,
    Connection,
    DeviceGone,
    DeviceSettings,
    DeviceSource,
    Frame,
)
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedDevice
from chachart.sources.live.wifi.frames import Selection
from chachart.sources.live.wifi.simulated import SimulatedTool, ToolFaults
from chachart.sources.live.wifi.tools import ChipName, Decoder, ToolName, decoder
from chachart.sources.live.wifi.ways import EthernetFrames, SerialPort, StandardInput, TcpServer, Udp, Way
from chachart.sources.simulator import Simulator, SimulatorSettings

PORTS: dict[str, int] = {
    "nexmon": 5500,
    "picoscenes": 50_000,
    "feitcsi": 8008,
    "intel5300": 8090,
    "openwifi": 4000,
}
QUIET_S = 0.25
"""After such a silence the last frame of a tool that sends it in parts has ended."""


class WifiLoopback(ToolFaults):
    """A simulated tool in this process: nothing needs to be plugged in."""

    scenario: SimulatorSettings = SimulatorSettings(ues=16, frame_rate_hz=200.0, snr_db=20.0)
    """What it hears."""


class WifiSettings(DeviceSettings):
    """Wi-Fi tools, live. Phase is random and delay relative: a packet says where, not how far.

    `tool` says how records come: `nexmon`, `picoscenes` (its UDP forwarder) and `openwifi` by UDP to `port`,
    `intel5300` (`log_to_server`) by TCP to `port`, `feitcsi` by UDP from `host`, `esp32` on a serial port,
    `nexmon_pcap` on standard input (`tcpdump -U -w -`) or from `interface`.
    """

    type: Literal["wifi"] = "wifi"
    """Which source."""
    tool: ToolName = "nexmon"
    """Which tool."""
    listen: str = Field("127.0.0.1", min_length=1, max_length=253)
    """Address of this machine that the tool sends to."""
    port: int | None = Field(None, ge=0, le=65535)
    """Its port; not set: the tool's usual one."""
    host: str = Field("127.0.0.1", min_length=1, max_length=253)
    """Where FeitCSI runs."""
    command: str = Field("--mode measure --frequency 5180 --channel-width 20 --format HT", max_length=1000)
    """What FeitCSI is asked for."""
    serial_port: str = Field("/dev/ttyUSB0", min_length=1)
    """Where an ESP32 is."""
    baudrate: int = Field(921_600, ge=1)
    """Of that port."""
    interface: str | None = Field(None, min_length=1, max_length=15)
    """With `nexmon_pcap`: the network interface to listen to, instead of standard input; needs root."""
    chip: ChipName = "integers"
    """How Nexmon's chip writes numbers: bcm4339 and bcm43455c0 are `integers`."""
    equalisers: int = Field(8, ge=0, le=64)
    """Results of the equaliser in openwifi's records."""
    power: Literal["auto", "rssi", "agc", "raw"] = "auto"
    """Scale frames to the received power, undo the gain control, or leave them; auto scales where it can."""
    loopback: WifiLoopback | bool = False
    """true, or a table: simulate the tool in this process. Its keys: `drop`, `corrupt`, `reorder` (fractions
    of the frames), `fault_seed`, and `scenario`, a simulator's settings."""

    def exposure(self, security: SecuritySettings) -> list[str]:
        """Wi-Fi tools know no keys: an address that other machines reach takes anybody's frames."""
        listens = self.tool in ("nexmon", "picoscenes", "openwifi", "intel5300") and not self.loopback
        where = f"udp://{self.listen}:{self.port or PORTS.get(self.tool, 0)}"
        if not listens or self.listen.startswith("127.") or where in security.without_keys:
            return []
        return [
            f"[source] tool {self.tool} sends to {self.listen}, which others can reach, and knows no keys: "
            f'name "{where}" in [security] without_keys to take whoever sends'
        ]


class WifiSource(DeviceSource):
    """One Wi-Fi packet is a frame; its sender, where the tool says it, the UE."""

    Settings: ClassVar[type[SourceSettings]] = WifiSettings
    facts = CaptureFacts(phase="random", delay="relative", power="rssi")
    settings: WifiSettings

    @property
    def where(self) -> str:
        """The tool, and where its records come from."""
        s = self.settings
        if s.loopback:
            return f"{s.tool} (loopback)"
        if s.tool == "esp32":
            return f"esp32 on {s.serial_port}"
        if s.tool == "nexmon_pcap":
            return f"nexmon on {s.interface or 'standard input'}"
        host = s.host if s.tool == "feitcsi" else s.listen
        return f"{s.tool} at {host}:{self._port()}"

    def simulate(self, address: Address = ANY_PORT) -> SimulatedDevice | None:
        """See `DeviceSource`."""
        told = self.settings.loopback
        if not told:
            return None
        loopback = told if isinstance(told, WifiLoopback) else WifiLoopback()
        return SimulatedTool(self.settings.tool, Simulator(loopback.scenario, self.array), loopback, address)

    def _connect(self) -> Connection:
        s = self.settings
        ethernet = s.interface is not None and self.simulated is None
        decode = decoder(s.tool, s.chip, s.equalisers, self.rejected, ethernet=ethernet)
        selection = Selection(self.array, s.power, self.rejected)
        return Records(self._way(), decode, selection, self.rejected)

    def _port(self) -> int:
        given = self.settings.port
        return PORTS.get(self.settings.tool, 0) if given is None else given

    def _way(self) -> Way:
        s, tool = self.settings, self.simulated
        if isinstance(tool, SimulatedTool):
            return tool.way()
        match s.tool:
            case "feitcsi":
                return Udp(("", 0), (s.host, self._port()), ask=s.command, stop="stop")
            case "intel5300":
                return TcpServer((s.listen, self._port()))
            case "esp32":
                return SerialPort(s.serial_port, s.baudrate)
            case "nexmon_pcap":
                return StandardInput() if s.interface is None else EthernetFrames(s.interface)
            case _:
                return Udp((s.listen, self._port()))


class Records(Connection):
    """A way on which a tool's records come, and the frames in them."""

    def __init__(self, way: Way, decode: Decoder, selection: Selection, rejected: Counters) -> None:
        self._way, self._decoder, self._selection, self._rejected = way, decode, selection, rejected
        self._latest_s, self._quiet = 0.0, True

    def frames(self, timeout: float) -> list[Frame] | None:
        """See `Connection`."""
        pieces = self._way.pieces(min(timeout, QUIET_S))
        now_s = time.monotonic()
        if pieces:
            self._latest_s, self._quiet = now_s, False
        elif self._quiet or now_s - self._latest_s < QUIET_S:
            return None
        else:
            self._quiet = True
        try:
            logs = self._decoder.feed(pieces)
        except CodecError as error:
            self._rejected.add(error.reason)
            raise DeviceGone(str(error)) from None
        now = time.time_ns()
        return [frame for log in logs for frame in self._selection.frames(log, now)]

    def close(self) -> None:
        """Let go of the way."""
        self._way.close()
