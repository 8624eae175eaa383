"""The source `krakensdr`: directions of whatever is on the air, from heimdall's coherent samples."""

from __future__ import annotations

import select
import socket
from contextlib import suppress
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
)
from chachart.sources.live.krakensdr import heimdall
from chachart.sources.live.krakensdr.bursts import bursts, factor
from chachart.sources.live.krakensdr.heimdall import Header
from chachart.sources.live.krakensdr.receiver import KrakenFaults, SimulatedKraken
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedDevice

CONNECT_S = 3.0
READ_BYTES = 1 << 20


class KrakenSettings(DeviceSettings):
    """KrakenSDR, or another receiver with heimdall, set to `out_data_iface_type = eth`.

    A UE is a frequency on which something transmits. There is no range: set rho = "none". A frame holds a
    covariance; `[array] subcarriers` is how many independent samples it is said to be worth.
    """

    type: Literal["krakensdr"] = "krakensdr"
    """Which source."""
    host: str = Field("127.0.0.1", min_length=1, max_length=253)
    """Where heimdall runs."""
    port: int = Field(5000, ge=1, le=65535)
    """Its port for IQ frames."""
    channel_width_hz: float = Field(12_500.0, gt=0)
    """The band is looked at in channels of this width."""
    squelch_db: float = Field(10.0, ge=0, le=100)
    """A channel is on the air when it is so far over the band's median."""
    loopback: KrakenFaults | bool = False
    """true, or a table: simulate a receiver in this process. Its keys: `transmitters` (`offset_hz`,
    `azimuth_deg`, `snr_db` each), `rate_hz`, `samples`, `frames`, `unsynchronous`, `overdrive`, `calibrating`
    (fractions of the frames), `fault_seed`."""


class KrakenSource(DeviceSource):
    """One frame a frequency on the air and acquisition."""

    Settings: ClassVar[type[SourceSettings]] = KrakenSettings
    settings: KrakenSettings

    @property
    def where(self) -> str:
        """Heimdall's address."""
        return "loopback" if self.settings.loopback else f"{self.settings.host}:{self.settings.port}"

    def simulate(self, address: Address = ANY_PORT) -> SimulatedDevice | None:
        """See `DeviceSource`."""
        told = self.settings.loopback
        if not told:
            return None
        return SimulatedKraken(
            self.array, told if isinstance(told, KrakenFaults) else KrakenFaults(), address
        )

    def _connect(self) -> Connection:
        if self.array.subcarriers < self.array.antennas:
            raise SetupError(
                f"[array] subcarriers = {self.array.subcarriers}: a covariance of {self.array.antennas} "
                f"antennas needs at least as many"
            )
        address = self.settings.host, self.settings.port
        if isinstance(self.simulated, SimulatedKraken):
            address = "127.0.0.1", self.simulated.port
        return Heimdall(address, self.array, self.settings, self.rejected)


class Heimdall(Connection):
    """A connection to heimdall: frames are asked for one by one.

    Raises
    ------
    SetupError
        If nobody listens there.
    """

    def __init__(
        self, address: tuple[str, int], array: ArrayGeometry, settings: KrakenSettings, rejected: Counters
    ) -> None:
        self._array, self._settings, self._rejected = array, settings, rejected
        self._waiting = bytearray()
        self._header: Header | None = None
        self._expected: int | None = None
        self._acquisitions = self._missed = 0
        try:
            self._socket = socket.create_connection(address, timeout=CONNECT_S)
            self._socket.sendall(heimdall.START)
        except OSError as error:
            raise SetupError(f"[source] no heimdall answers at {address[0]}:{address[1]}: {error}") from None

    def frames(self, timeout: float) -> list[Frame] | None:
        """See `Connection`."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return None
        try:
            data = self._socket.recv(READ_BYTES)
        except OSError as error:
            raise DeviceGone(str(error)) from None
        if not data:
            raise DeviceGone("heimdall has hung up")
        self._waiting += data
        try:
            return self._acquisition()
        except CodecError as error:
            self._rejected.add(error.reason)
            raise DeviceGone(str(error)) from None

    def close(self) -> None:
        """Hang up."""
        with suppress(OSError):  # it may have gone already
            self._socket.sendall(heimdall.QUIT)
        self._socket.close()

    def details(self) -> dict[str, Any]:
        """Acquisitions that came whole, and those that were missed by their numbers."""
        return {"acquisitions": self._acquisitions, "missed": self._missed}

    def _acquisition(self) -> list[Frame]:
        """The frames in an acquisition that has come whole; the next one is asked for."""
        if self._header is None:
            if len(self._waiting) < heimdall.HEADER_BYTES:
                return []
            self._header = heimdall.decode_header(bytes(self._waiting[: heimdall.HEADER_BYTES]))
        header = self._header
        whole = heimdall.HEADER_BYTES + header.payload_bytes
        if len(self._waiting) < whole:
            return []
        payload = bytes(self._waiting[heimdall.HEADER_BYTES : whole])
        del self._waiting[:whole]
        self._header = None
        try:
            self._socket.sendall(heimdall.NEXT)
        except OSError as error:
            raise DeviceGone(str(error)) from None
        return self._frames_in(header, payload)

    def _frames_in(self, header: Header, payload: bytes) -> list[Frame]:
        self._acquisitions += 1
        if self._expected is not None and header.index > self._expected:
            self._missed += header.index - self._expected
        self._expected = header.index + 1
        if (reason := header.unusable) is not None:
            self._rejected.add(reason)
            return []
        if header.channels != self._array.antennas:
            self._rejected.add("shape")
            return []
        s = self._settings
        found = bursts(
            heimdall.decode_samples(header, payload),
            header.centre_hz,
            header.rate_hz,
            s.channel_width_hz,
            s.squelch_db,
        )
        snapshots = self._array.subcarriers
        return [Frame(b.frequency_hz, header.time_ns, factor(b.covariance, snapshots)) for b in found]
