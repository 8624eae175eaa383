"""A simulated gNB: a T tracer on TCP whose sounding reference signals are what a source says."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from chachart.node.data.settings import Settings
from chachart.sources.base import EndOfSource, Source
from chachart.sources.live.oai.tracer import (
    CHUNK,
    END,
    Description,
    Event,
    Value,
    encode_arguments,
    encode_event,
)
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedServer

DESCRIPTIONS = """\
ID = LEGACY_PHY_INFO
    DESC = PHY info messages
    GROUP = ALL:LEGACY
    FORMAT = string,log
ID = GNB_PHY_UL_TICK
    GROUP = ALL:PHY
    FORMAT = int,gNB_ID : int,frame : int,slot
ID = GNB_PHY_UL_FREQ_CHANNEL_ESTIMATE
    GROUP = ALL:PHY:GRAPHIC
    FORMAT = int,gNB_ID : int,rnti : int,frame : int,subframe : int,antenna : int,port : buffer,chest_t
"""
ESTIMATE = Description(
    "GNB_PHY_UL_FREQ_CHANNEL_ESTIMATE",
    (
        ("int", "gNB_ID"),
        ("int", "rnti"),
        ("int", "frame"),
        ("int", "subframe"),
        ("int", "antenna"),
        ("int", "port"),
        ("buffer", "chest_t"),
    ),
)
_TICK, ESTIMATE_EVENT = 1, 2
_CHUNK_BYTES = 100
FULL_SCALE = 8000.0
FRAMES = 1024


class GnbFaults(Settings):
    """How a simulated gNB sends, and what goes wrong."""

    fft_size: int = Field(512, ge=128, le=8192)
    """Tones of its FFT."""
    spacing_hz: float = Field(30_000.0, gt=0)
    """Distance between neighbouring tones."""
    drop: float = Field(0.0, ge=0, le=1)
    """Fraction of the soundings of which one antenna is never sent."""
    corrupt: float = Field(0.0, ge=0, le=1)
    """Fraction of the soundings of which one antenna's estimate is cut short."""
    fault_seed: int = Field(0, ge=0)
    """Same seed, same faults."""


@dataclass(slots=True)
class GnbReport:
    """Soundings that were sent whole, and of which one antenna was dropped or cut."""

    sent: int = 0
    dropped: int = 0
    corrupted: int = 0


class SimulatedGnb(SimulatedServer):
    """A gNB that hears what a source says. `start` it, point an `oai` source at `port`, `stop` it.

    Parameters
    ----------
    source
        What it hears; not open yet. It is played while a client is there.
    step
        Every how many-th tone of the FFT the source's subcarriers are; the others are interpolated.
    """

    def __init__(self, source: Source, step: int, faults: GnbFaults, address: Address = ANY_PORT) -> None:
        super().__init__(address)
        self._report = GnbReport()
        self._source, self._step, self._faults = source, step, faults
        self._rng = np.random.default_rng(faults.fault_seed)
        self._frame: dict[int, int] = {}

    @property
    def report(self) -> GnbReport:
        """What has become of what it sent."""
        return self._report

    def run(self) -> None:
        """Serve clients while the source is open, in the thread."""
        with self._source:
            super().run()

    def serve(self, client: socket.socket) -> None:
        """See `SimulatedServer`."""
        client.settimeout(5.0)
        for event in _descriptions():
            client.sendall(encode_event(event))
        if not _wants(client):
            return
        while not self.stopping.is_set():
            try:
                block = self._source.recv(0.05)
            except EndOfSource:
                self.ended.set()
                self.stopping.wait()
                return
            if block is not None:
                for ue, time_ns, csi in zip(
                    block.ue.tolist(), block.time_ns.tolist(), block.csi, strict=True
                ):
                    client.sendall(self.sounding(ue, time_ns, csi))

    def sounding(self, ue: int, time_ns: int, csi: NDArray[np.complex64]) -> bytes:
        """The events of a frame (antennas, tones), whole or with a fault, which is counted."""
        self._frame[ue] = (self._frame.get(ue, -1) + 1) % FRAMES
        odd, fault = int(self._rng.integers(len(csi))), float(self._rng.random())
        drop, cut = fault < self._faults.drop, fault < self._faults.drop + self._faults.corrupt
        self._report.dropped += drop
        self._report.corrupted += cut and not drop
        self._report.sent += not cut
        scale = FULL_SCALE / float(np.abs(csi).max())
        parts = [encode_event(Event(time_ns, _TICK, struct.pack("<3i", 0, self._frame[ue], 0)))]
        for antenna, row in enumerate(csi):
            if antenna == odd and drop:
                continue
            chest = self._spread(row * scale)
            if antenna == odd and cut:
                chest = chest[:-3]
            values: dict[str, Value] = {
                "gNB_ID": 0, "rnti": ue & 0xFFFF, "frame": self._frame[ue], "subframe": 0,
                "antenna": antenna, "port": 0, "chest_t": chest,
            }  # fmt: skip
            parts.append(encode_event(Event(time_ns, ESTIMATE_EVENT, encode_arguments(ESTIMATE, values))))
        return b"".join(parts)

    def _spread(self, row: NDArray[np.complex64]) -> bytes:
        """The row's values at every `step`-th tone, lines between them, in the order of the FFT, as int16."""
        count = (len(row) - 1) * self._step + 1
        at = np.arange(count) / self._step
        between = np.interp(at, np.arange(len(row)), row.real) + 1j * np.interp(
            at, np.arange(len(row)), row.imag
        )
        tones = np.zeros(self._faults.fft_size, np.complex64)
        first = (self._faults.fft_size - count) // 2
        tones[first : first + count] = between
        pairs = np.fft.ifftshift(tones).view(np.float32)
        return np.rint(pairs).astype("<i2").tobytes()


def _descriptions() -> Iterator[Event]:
    text = DESCRIPTIONS.encode()
    for at in range(0, len(text), _CHUNK_BYTES):
        part = text[at : at + _CHUNK_BYTES]
        yield Event(0, CHUNK, struct.pack("<i", len(part)) + part)
    yield Event(0, END, b"")


def _wants(client: socket.socket) -> bool:
    """Whether the client switches the estimates on."""
    head = _exactly(client, 5)
    kind, count = struct.unpack("<bi", head)
    if kind not in (0, 1) or not 0 <= count <= 65536:
        return False
    numbers = struct.unpack(f"<{count}i", _exactly(client, 4 * count))
    return ESTIMATE_EVENT in numbers if kind == 0 else count > ESTIMATE_EVENT and numbers[ESTIMATE_EVENT] == 1


def _exactly(client: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = client.recv(size - len(data))
        if not more:
            raise OSError("the client has gone")
        data += more
    return data
