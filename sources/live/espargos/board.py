"""A simulated ESPARGOS board: what its controller answers, what its sensors make of a Wi-Fi packet."""

from __future__ import annotations

import json
import threading
import time
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from chachart.node.data.settings import Settings
from chachart.sources.base import EndOfSource, Source
from chachart.sources.live.espargos import control, message, stream
from chachart.sources.live.espargos.calibration import trace_delay_s
from chachart.sources.live.espargos.cluster import ANTENNAS, Cluster
from chachart.sources.live.espargos.control import Channel
from chachart.sources.live.espargos.message import SUBCARRIER_SPACING_HZ, UNIT_NS, SensorCsi
from chachart.sources.live.simulated import SimulatedDevice

REFERENCE_HZ = 100.0
"""Reference packets a second while the switch is at the reference."""
BOARD_ADDRESS = 0x020000000001
LATE_PACKETS = 4
FULL_SCALE = 1500.0
"""What the gain control makes of a packet's largest value, of 2047."""


class BoardFaults(Settings):
    """What is wrong with a simulated board, and what goes wrong on the way."""

    corrupt: float = Field(0.0, ge=0, le=1)
    """Fraction of the packets of which one sensor's message is damaged."""
    drop: float = Field(0.0, ge=0, le=1)
    """Fraction of the packets of which one sensor's message is never sent."""
    reorder: float = Field(0.0, ge=0, le=1)
    """Fraction of the packets of which one sensor's message comes a few packets late."""
    clock_ns: float = Field(40.0, ge=0, le=1000)
    """Offsets of the sensors' clocks lie within so much of each other."""
    fault_seed: int = Field(0, ge=0)
    """Same seed, same faults, clocks and phases."""


@dataclass(slots=True)
class BoardReport:
    """What became of the packets: sent whole, of those late in part; dropped and corrupted at one sensor."""

    sent: int = 0
    dropped: int = 0
    corrupted: int = 0
    reordered: int = 0
    references: int = 0


def _just_booted() -> int:
    return time.time_ns() - 100_000_000_000


@dataclass(frozen=True, slots=True)
class Wiring:
    """How a board is connected to others.

    Attributes
    ----------
    number
        Which of the boards it is.
    boot_ns
        When its clock was zero; boards on one clock have one such time, and the same packets' phases.
    cable_s
        Delay of the cable that brings it the common reference.
    """

    number: int = 0
    boot_ns: int = field(default_factory=_just_booted)
    cable_s: float = 0.0


class SimulatedBoard(SimulatedDevice):
    """A board that hears what a source says, whichever way it is asked and listened to.

    Parameters
    ----------
    source
        Frames of 8 antennas and the tones of `message.TONES`; not open yet. Played while somebody streams.
    channel
        What the controller says it listens on.
    faults
        What is wrong.
    wiring
        How it is connected to other boards.
    """

    def __init__(
        self, source: Source, channel: Channel, faults: BoardFaults, wiring: Wiring | None = None
    ) -> None:
        super().__init__()
        self._report = BoardReport()
        self._source, self._channel, self._faults = source, channel, faults
        self._wiring = wiring or Wiring()
        self._rng = np.random.default_rng([faults.fault_seed, self._wiring.number])
        self._clock_s = self._rng.uniform(0, faults.clock_ns * 1e-9, ANTENNAS)
        self._phase = np.exp(1j * self._rng.uniform(-np.pi, np.pi, ANTENNAS))
        self._sequence: dict[int, int] = {}
        self._number = 0
        self._late: deque[tuple[int, bytes]] = deque()
        self._switch = control.ANTENNAS
        self._greeted = False
        self._stopping = threading.Event()
        self._last_reference = 0
        self._thread = threading.Thread(target=self._play, name="board", daemon=True)

    @property
    def report(self) -> BoardReport:
        """What has become of what it sent."""
        return self._report

    def start(self) -> None:
        """Listen."""
        self._thread.start()

    def stop(self) -> None:
        """End everything."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def answer(self, path: str, body: bytes) -> str | None:
        """What the controller says to a request; None to one that it does not know."""
        if path == "/identify":
            return "ESPARGOS"
        if path == "/api_info":
            return json.dumps(
                {"api-major": 3, "api-minor": 0, "device": "espargos", "revision": "densiflorus"}
            )
        if path == "/get_wificonf":
            secondary = {0: 0, 1: 1, -1: 2}[self._channel.secondary]
            return json.dumps({"channel-primary": self._channel.primary, "channel-secondary": secondary})
        if path == "/set_csi_acquire_config":
            return "ok"
        if path == "/set_rfswitch":
            self._switch = int(body)
            return "ok"
        return None

    @property
    @abstractmethod
    def listened(self) -> bool:
        """Whether somebody wants sensor packets."""

    @abstractmethod
    def greet(self) -> None:
        """What comes before the first sensor packet."""

    @abstractmethod
    def send(self, packet: bytes) -> None:
        """Send a sensor packet to whoever listens."""

    def _play(self) -> None:
        with self._source:
            while not self._stopping.is_set():
                if not self.listened:
                    self._greeted = False
                    self._stopping.wait(0.01)
                elif not self._greeted:
                    self.greet()
                    self._greeted = True
                elif self._switch == control.REFERENCE:
                    self._reference()
                    self._stopping.wait(0.5 / REFERENCE_HZ)
                elif not self._hear():
                    break
        self.ended.set()

    def _hear(self) -> bool:
        """Play what the source has; False when it has ended."""
        try:
            block = self._source.recv(0.05)
        except EndOfSource:
            self._release(everything=True)
            return False
        if block is not None:
            number = [self._next(ue) for ue in block.ue.tolist()] if block.packet is None else block.packet
            for n, packet in enumerate(np.asarray(number).tolist()):
                self._packet(int(block.ue[n]), packet, int(block.time_ns[n]), block.csi[n])
        return True

    def _reference(self) -> None:
        """The next packet that the board sends to itself, or that all boards on one clock get from one."""
        number = int(time.time() * REFERENCE_HZ)
        if number == self._last_reference:
            return
        self._last_reference = number
        frequency = self._channel.packet_hz + message.TONES * SUBCARRIER_SPACING_HZ
        path_s = trace_delay_s() + self._wiring.cable_s
        csi = np.exp(-2j * np.pi * path_s[:, None] * frequency).astype(np.complex64)
        self._packet(BOARD_ADDRESS, number, int(number / REFERENCE_HZ * 1e9), csi, calibration=True)
        self._report.references += 1

    def _packet(
        self, ue: int, number: int, time_ns: int, csi: NDArray[np.complex64], *, calibration: bool = False
    ) -> None:
        """Send what each sensor makes of a packet: phases, and where it takes the beginning to be."""
        of_all = np.random.default_rng([self._faults.fault_seed, ue, number])
        began = (time_ns - self._wiring.boot_ns) * 1e-9 + of_all.uniform(0, 1e-6) + self._clock_s
        half_ns = np.round(began * 1e9 / UNIT_NS).astype(np.int64) * round(2 * UNIT_NS)
        early = half_ns * 0.5e-9 - began
        first = SensorCsi(
            source=ue & (1 << 48) - 1,
            destination=(1 << 48) - 1,
            sequence=number % 4096 << 4,
            retry=False,
            calibration=calibration,
            time_half_ns=0,
            csi=csi[0],
            rssi_dbm=-50,
            noise_dbm=-95,
            channel=self._channel.primary,
            secondary=self._channel.secondary,
        )
        tones = Cluster(first, csi, early).tones()
        turns = np.exp(
            2j * np.pi * SUBCARRIER_SPACING_HZ * early[:, None] * tones + 1j * of_all.uniform(0, 2 * np.pi)
        )
        heard = csi * turns * self._phase[:, None]
        peak = float(np.abs(heard.view(np.float64)).max()) or 1.0
        gain = int(np.clip(np.floor(20 * np.log10(FULL_SCALE / peak)), -100, 100))
        messages = [
            message.encode_message(
                replace(first, csi=heard[n].astype(np.complex64), time_half_ns=int(half_ns[n])), gain
            )
            for n in range(ANTENNAS)
        ]
        self._dispatch(messages, calibration)

    def _dispatch(self, messages: list[bytes], calibration: bool) -> None:
        self._number += 1
        odd, fault = int(self._rng.integers(ANTENNAS)), float(self._rng.random())
        faults = self._faults
        if calibration:
            fault = 1.0
        for antenna, body in enumerate(messages):
            datagram = self._datagram(antenna, body)
            if antenna == odd and fault < faults.drop:
                self._report.dropped += 1
                continue
            if antenna == odd and fault < faults.drop + faults.corrupt:
                self._report.corrupted += 1
                datagram = self._datagram(antenna, self._damaged(body))
            elif antenna == odd and fault < faults.drop + faults.corrupt + faults.reorder:
                self._report.reordered += 1
                self._late.append((self._number + int(self._rng.integers(1, LATE_PACKETS)), datagram))
                continue
            self.send(datagram)
        if not calibration and fault >= faults.drop + faults.corrupt:
            self._report.sent += 1
        self._release()

    def _datagram(self, antenna: int, body: bytes) -> bytes:
        """A sensor packet; every other message comes in two fragments."""
        uid = antenna << 29 | (self._number & 0x1FFFFFFF) or 1
        cut = len(body) // 2 if self._number % 2 else len(body)
        parts = [body[:cut], body[cut:]] if cut < len(body) else [body]
        fragments = [stream.Fragment(uid, i, len(parts), part) for i, part in enumerate(parts)]
        return stream.encode_packet(fragments)

    def _damaged(self, body: bytes) -> bytes:
        at = int(self._rng.integers(8, len(body)))
        return body[:at] + bytes([body[at] ^ int(self._rng.integers(1, 256))]) + body[at + 1 :]

    def _release(self, everything: bool = False) -> None:
        while self._late and (everything or self._late[0][0] <= self._number):
            self.send(self._late.popleft()[1])

    def _next(self, ue: int) -> int:
        self._sequence[ue] = (self._sequence.get(ue, -1) + 1) % 4096
        return self._sequence[ue]
