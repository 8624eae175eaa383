"""A simulated KrakenSDR: heimdall's server, with transmitters on the air around its antennas."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.settings import Settings
from chachart.sources.live.krakensdr import heimdall
from chachart.sources.live.krakensdr.heimdall import Header
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedServer


class Transmitter(Settings):
    """A transmitter far away."""

    offset_hz: float = 200_000.0
    """Of its carrier from the middle of the band."""
    azimuth_deg: float = Field(30.0, ge=-180, le=180)
    """Its direction, counted from the array's first axis."""
    snr_db: float = Field(10.0, ge=-60, le=100)
    """Over the noise in the whole band."""


class KrakenFaults(Settings):
    """What a simulated receiver hears, and what is wrong with it."""

    transmitters: tuple[Transmitter, ...] = (
        Transmitter(),
        Transmitter(offset_hz=-400_000.0, azimuth_deg=-60.0),
    )
    """Who is on the air."""
    rate_hz: int = Field(2_400_000, ge=1000, le=1 << 30)
    """Samples a second."""
    samples: int = Field(16384, ge=64, le=1 << 20)
    """Samples a frame and channel."""
    frames: int | None = Field(None, ge=1)
    """End after so many frames; not set: never."""
    unsynchronous: float = Field(0.0, ge=0, le=1)
    """Fraction of the frames that say that the channels are not aligned."""
    overdrive: float = Field(0.0, ge=0, le=1)
    """Fraction of the frames that say that a converter was driven too far."""
    calibrating: float = Field(0.0, ge=0, le=1)
    """Fraction of the frames that hold the noise source."""
    fault_seed: int = Field(0, ge=0)
    """Same seed, same noise and faults."""


@dataclass(slots=True)
class KrakenReport:
    """Frames that were sent, by what they are good for."""

    good: int = 0
    unsynchronous: int = 0
    overdriven: int = 0
    calibrating: int = 0


class SimulatedKraken(SimulatedServer):
    """A receiver. `start` it, point a `krakensdr` source at `port`, `stop` it.

    Parameters
    ----------
    array
        Its antennas.
    """

    def __init__(self, array: ArrayGeometry, faults: KrakenFaults, address: Address = ANY_PORT) -> None:
        super().__init__(address)
        self._report = KrakenReport()
        self._array, self._faults = array, faults
        self._rng = np.random.default_rng(faults.fault_seed)
        self._sent = 0

    @property
    def report(self) -> KrakenReport:
        """What has become of what it sent."""
        return self._report

    def serve(self, client: socket.socket) -> None:
        """See `SimulatedServer`."""
        client.settimeout(0.05)
        wanted = heimdall.START
        while not self.stopping.is_set():
            asked = self._asked(client, len(wanted))
            if asked != wanted:
                return
            wanted = heimdall.NEXT
            if self._faults.frames is not None and self._sent >= self._faults.frames:
                self.ended.set()
                self.stopping.wait()
                return
            client.settimeout(5.0)
            client.sendall(self.acquisition())
            client.settimeout(0.05)
            self._sent += 1

    def _asked(self, client: socket.socket, size: int) -> bytes:
        data = b""
        while len(data) < size and not self.stopping.is_set():
            try:
                more = client.recv(size - len(data))
            except TimeoutError:
                continue
            if not more:
                return data
            data += more
        return data

    def acquisition(self) -> bytes:
        """What heimdall sends next, good or not, which is counted."""
        f, fault = self._faults, float(self._rng.random())
        good = Header(
            type=heimdall.DATA,
            channels=self._array.antennas,
            samples=f.samples,
            depth_bits=32,
            centre_hz=round(self._array.carrier_hz),
            rate_hz=f.rate_hz,
            time_ns=time.time_ns(),
            index=self._sent,
            overdrive=0,
            delay_synchronous=True,
            iq_synchronous=True,
        )
        if fault < f.unsynchronous:
            self._report.unsynchronous += 1
            header = replace(good, iq_synchronous=False)
        elif fault < f.unsynchronous + f.overdrive:
            self._report.overdriven += 1
            header = replace(good, overdrive=1)
        elif fault < f.unsynchronous + f.overdrive + f.calibrating:
            self._report.calibrating += 1
            header = replace(good, type=heimdall.CALIBRATION)
        else:
            self._report.good += 1
            header = good
        return heimdall.encode_frame(header, self._samples())

    def _samples(self) -> NDArray[np.complex64]:
        f, positions = self._faults, self._array.element_positions()
        shape = self._array.antennas, f.samples
        samples = (self._rng.standard_normal(shape) + 1j * self._rng.standard_normal(shape)) * np.sqrt(0.5)
        first, second = np.asarray(self._array.axis), np.asarray(self._array.broadside)
        for t in f.transmitters:
            azimuth = np.radians(t.azimuth_deg)
            direction = np.cos(azimuth) * first + np.sin(azimuth) * second
            wave = np.exp(
                2j * np.pi / self._array.wavelength_m * (positions - self._array.centre_m) @ direction
            )
            at = 2 * np.pi * t.offset_hz / f.rate_hz * np.arange(f.samples)
            tone = np.exp(1j * (at + self._rng.uniform(0, 2 * np.pi))) * 10 ** (t.snr_db / 20)
            samples += wave[:, None] * tone
        heard: NDArray[np.complex64] = samples.astype(np.complex64)
        return heard
