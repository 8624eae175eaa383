"""The source `oai`: live channel estimates of 5G UEs from an OpenAirInterface gNB."""

from __future__ import annotations

import logging
import select
import socket
from typing import Any, ClassVar, Literal

from pydantic import Field

from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import SourceSettings
from chachart.sources.live.device import (
    CodecError,
    Connection,
    DeviceGone,
    DeviceSettings,
    DeviceSource,
    Frame,
    count,
)
from chachart.sources.live.oai import srs, tracer
from chachart.sources.live.oai.gnb import GnbFaults, SimulatedGnb
from chachart.sources.live.oai.tracer import CHUNK, END, Description, Event, EventStream
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedDevice
from chachart.sources.simulator import Simulator, SimulatorSettings

log = logging.getLogger(__name__)

CONNECT_S = 3.0
READ_BYTES = 1 << 20


class OaiLoopback(GnbFaults):
    """A simulated gNB in this process: nothing needs to run."""

    scenario: SimulatorSettings = SimulatorSettings(ues=32, frame_rate_hz=200.0, snr_db=20.0)
    """What it hears; numbers of UEs are cut to 16 bits."""


class OaiSettings(DeviceSettings):
    """The T tracer of an OpenAirInterface gNB, run with `--T_stdout 2 --T_nowait`. A UE is its RNTI.

    A frame is a sounding at all antennas; phase is random, delay relative to the UE's timing advance.
    """

    type: Literal["oai"] = "oai"
    """Which source."""
    host: str = Field("127.0.0.1", min_length=1, max_length=253)
    """Where the gNB runs."""
    port: int = Field(2021, ge=1, le=65535)
    """Its `--T_port`."""
    srs_port: int = Field(0, ge=0, le=7)
    """Which antenna port of the UEs counts."""
    spacing_hz: float = Field(30_000.0, gt=0)
    """Distance between the gNB's tones, by its numerology; the array's subcarriers are every n-th of them."""
    symbols: int = Field(1, ge=1, le=14)
    """Symbols in an estimate."""
    loopback: OaiLoopback | bool = False
    """true, or a table: simulate a gNB in this process. Its keys: `fft_size`, `spacing_hz`, `drop`, `corrupt`
    (fractions of the soundings), `fault_seed`, and `scenario`, a simulator's settings."""


class OaiSource(DeviceSource):
    """One sounding that all antennas heard is a frame."""

    Settings: ClassVar[type[SourceSettings]] = OaiSettings
    settings: OaiSettings

    @property
    def where(self) -> str:
        """The gNB's address."""
        return "loopback" if self.settings.loopback else f"{self.settings.host}:{self.settings.port}"

    def simulate(self, address: Address = ANY_PORT) -> SimulatedDevice | None:
        """See `DeviceSource`."""
        told = self.settings.loopback
        if not told:
            return None
        loopback = told if isinstance(told, OaiLoopback) else OaiLoopback()
        return SimulatedGnb(Simulator(loopback.scenario, self.array), self._tone_step(), loopback, address)

    def _connect(self) -> Connection:
        address = self.settings.host, self.settings.port
        if isinstance(self.simulated, SimulatedGnb):
            address = "127.0.0.1", self.simulated.port
        return Tracer(address, self.array, self._tone_step(), self.settings, self.rejected)

    def _tone_step(self) -> int:
        wanted, spacing = self.array.subcarrier_spacing_hz, self.settings.spacing_hz
        step = srs.tone_step(wanted, spacing)
        if step is None:
            raise SetupError(
                f"[array] subcarrier_spacing_hz = {wanted:g} must be a multiple of the gNB's {spacing:g} Hz"
            )
        return step


class Tracer(Connection):
    """A connection to a tracer.

    Raises
    ------
    SetupError
        If nobody listens there.
    """

    def __init__(
        self,
        address: tuple[str, int],
        array: ArrayGeometry,
        step: int,
        settings: OaiSettings,
        rejected: Counters,
    ) -> None:
        self._array, self._step, self._settings, self._rejected = array, step, settings, rejected
        self._events = EventStream()
        self._soundings = srs.Soundings(array.antennas, rejected)
        self._text = bytearray()
        self._wanted: dict[int, Description] = {}
        try:
            self._socket = socket.create_connection(address, timeout=CONNECT_S)
        except OSError as error:
            raise SetupError(f"[source] no T tracer answers at {address[0]}:{address[1]}: {error}") from None

    def frames(self, timeout: float) -> list[Frame] | None:
        """See `Connection`."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return None
        try:
            data = self._socket.recv(READ_BYTES)
        except OSError as error:
            raise DeviceGone(str(error)) from None
        if not data:
            raise DeviceGone("the gNB has hung up")
        frames: list[Frame] = []
        try:
            for event in self._events.feed(data):
                frames += self._take(event)
        except CodecError as error:
            self._rejected.add(error.reason)
            raise DeviceGone(str(error)) from None
        return frames

    def close(self) -> None:
        """Hang up."""
        self._socket.close()

    def details(self) -> dict[str, Any]:
        """Which events the gNB gives."""
        return {"events": sorted(description.name for description in self._wanted.values())}

    def _take(self, event: Event) -> list[Frame]:
        if event.type == CHUNK:
            self._text += tracer.chunk_text(event.body)
            if len(self._text) > tracer.LONGEST_TEXT:
                raise CodecError("descriptions", "the descriptions do not end")
        elif event.type == END:
            self._subscribe(tracer.parse_descriptions(self._text.decode("utf-8", "replace")))
        elif event.type in self._wanted:
            try:
                return self._sounding(
                    tracer.decode_arguments(self._wanted[event.type], event.body), event.time_ns
                )
            except CodecError as error:
                count(error, self._rejected)
        return []

    def _subscribe(self, described: list[Description]) -> None:
        for name in srs.EVENTS:
            self._wanted = {i: d for i, d in enumerate(described) if d.name == name}
            if self._wanted:
                break
        else:
            raise CodecError("events", f"this gNB has none of the events {', '.join(srs.EVENTS)}")
        try:
            self._socket.sendall(tracer.subscription(set(self._wanted), len(described)))
        except OSError as error:
            raise DeviceGone(str(error)) from None

    def _sounding(self, values: dict[str, tracer.Value], time_ns: int) -> list[Frame]:
        heard = srs.estimate(values, self._settings.symbols)
        if heard.port != self._settings.srs_port:
            return []
        csi = srs.used(heard.tones, self._step, self._array.subcarriers)
        whole = self._soundings.add(heard, csi)
        return [] if whole is None else [Frame(heard.rnti, time_ns, whole)]
