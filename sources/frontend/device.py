"""A simulated front-end: plays any source of CSI as if it were the device, with faults on request."""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.settings import Means, Settings
from chachart.sources.base import EndOfSource, Source
from chachart.sources.frontend.packet import CsiPacket, Heartbeat, Hello, Packet, SampleFormat, encode

log = logging.getLogger(__name__)

HELLO_S = 5.0
HEARTBEAT_S = 1.0
LATEST = 8
"""A reordered packet comes at most so many packets late."""


class FaultSettings(Settings):
    """How a simulated front-end sends, and what goes wrong on the way."""

    format: Literal["int8", "int16", "float32"] = "int16"
    """How one real number (I or Q) is sent."""
    serial_number: Annotated[str, Means("of at most 16 ASCII characters")] = Field(
        "SIM-1", max_length=16, pattern=r"^[ -~]*$"
    )
    """What it says it is."""
    corrupt: float = Field(0.0, ge=0, le=1)
    """Fraction of the frames in which bytes are flipped, lost or inserted on the link."""
    drop: float = Field(0.0, ge=0, le=1)
    """Fraction of the frames that are never sent."""
    reorder: float = Field(0.0, ge=0, le=1)
    """Fraction of the frames that are sent a few frames late."""
    unplug_every_s: float | None = Field(None, gt=0)
    """Unplug the link so often; not set: never."""
    unplug_every_frames: int | None = Field(None, ge=1)
    """Unplug the device whenever it has sent so many frames."""
    unplugged_s: float = Field(1.0, gt=0)
    """How long it stays unplugged."""
    fault_seed: int = Field(0, ge=0)
    """Same seed, same faults."""


@dataclass(slots=True)
class Report:
    """What became of the frames of a simulated front-end; each is counted once.

    Attributes
    ----------
    sent, reordered
        Put on the link whole, in order and late.
    dropped, corrupted
        Lost on request.
    unplugged, unheard
        Lost because the link was unplugged, or because nobody at its other end took them.
    """

    sent: int = 0
    reordered: int = 0
    dropped: int = 0
    corrupted: int = 0
    unplugged: int = 0
    unheard: int = 0

    @property
    def arriving(self) -> int:
        """Frames that reach the node whole."""
        return self.sent + self.reordered

    @property
    def lost(self) -> int:
        """Frames that do not."""
        return self.dropped + self.corrupted + self.unplugged + self.unheard


class Link(ABC):
    """One end of a line to a node.

    Attributes
    ----------
    connections
        How often somebody at the other end has begun to listen.
    stopping
        Set by whoever wants `send` to give up.
    """

    def __init__(self) -> None:
        self.connections = 0
        self.stopping = threading.Event()

    @property
    @abstractmethod
    def where(self) -> str:
        """What the node is told to listen to."""

    @abstractmethod
    def wait_ready(self, timeout: float) -> bool:
        """Whether somebody listens, or begins to within `timeout` seconds."""

    @abstractmethod
    def send(self, packet: bytes, damage: np.random.Generator | None = None) -> bool:
        """Send a packet, damaged at random where a generator is given; False if it could not be sent."""

    @abstractmethod
    def unplug(self) -> None:
        """Let what was sent arrive, then cut the line."""

    @abstractmethod
    def plug(self) -> None:
        """Mend it."""

    @abstractmethod
    def close(self) -> None:
        """Let go of it. May be called twice."""


class SimulatedFrontEnd:
    """Plays a source over a link until the source ends or `stop` is called.

    Parameters
    ----------
    source
        What it plays; not open yet.
    link
        Where to.
    faults
        What goes wrong.
    clock
        Seconds, for heartbeats and unplugging.
    """

    def __init__(
        self,
        source: Source,
        link: Link,
        faults: FaultSettings,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.report = Report()
        self._source = source
        self._link = link
        self._faults = faults
        self._clock = clock
        self._rng = np.random.default_rng(faults.fault_seed)
        self._format = SampleFormat[faults.format.upper()]
        self._seq = 0
        self._played = 0
        self._start_ns: int | None = None
        self._now_ns = 0
        self._late: deque[tuple[int, bytes]] = deque()
        self._greeted = 0
        self._next_hello = self._next_heartbeat = 0.0

    def run(self) -> Report:
        """Play to the end; the report of it."""
        every = self._faults.unplug_every_s
        unplug_at = self._clock() + every if every else float("inf")
        frames = self._faults.unplug_every_frames
        unplug_after = frames if frames else float("inf")
        with self._source:
            while not self._link.stopping.is_set():
                if self._clock() >= unplug_at or self._played >= unplug_after:
                    self._unplugged()
                    unplug_at = self._clock() + every if every else float("inf")
                    unplug_after = self._played + frames if frames else float("inf")
                if not self._link.wait_ready(0.1):
                    continue
                self._show_signs_of_life()
                try:
                    block = self._source.recv(0.1)
                except EndOfSource:
                    break
                if block is not None:
                    self._play(block)
                    self._played += len(block)
        self._release(all_of_them=True)
        self._send(Heartbeat(self._seq, self._now_ns))
        return self.report

    def _play(self, block: CsiBlock) -> None:
        for row in range(len(block)):
            packet = self._packet(block, row)
            fault = self._rng.random()
            faults = self._faults
            if fault < faults.drop:
                self.report.dropped += 1
            elif fault < faults.drop + faults.corrupt:
                if self._link.send(packet, self._rng):
                    self.report.corrupted += 1
                else:
                    self.report.unheard += 1
            elif fault < faults.drop + faults.corrupt + faults.reorder:
                self._late.append((self._seq + int(self._rng.integers(1, LATEST)), packet))
            elif self._link.send(packet):
                self.report.sent += 1
            else:
                self.report.unheard += 1
            self._release()

    def _packet(self, block: CsiBlock, row: int) -> bytes:
        """Frame `row` as the device sends it; its clock starts when it does."""
        time_ns = int(block.time_ns[row])
        if self._start_ns is None:
            self._start_ns = time_ns - 1
        self._now_ns = max(time_ns - self._start_ns, 1)
        packet = CsiPacket.quantise(self._seq, self._now_ns, int(block.ue[row]), block.csi[row], self._format)
        self._seq = (self._seq + 1) % (1 << 32)
        return encode(packet)

    def _release(self, all_of_them: bool = False) -> None:
        """Send the late packets that are due."""
        while self._late and (all_of_them or self._late[0][0] <= self._seq):
            if self._link.send(self._late.popleft()[1]):
                self.report.reordered += 1
            else:
                self.report.unheard += 1

    def _unplugged(self) -> None:
        """Cut the line for a while; a live source goes on without anybody hearing it."""
        self._release(all_of_them=True)
        self._link.unplug()
        until = self._clock() + self._faults.unplugged_s
        while self._clock() < until and not self._link.stopping.is_set():
            if self._source.lossless:
                self._link.stopping.wait(0.01)
                continue
            try:
                block = self._source.recv(0.05)
            except EndOfSource:
                break
            if block is not None:
                self._seq = (self._seq + len(block)) % (1 << 32)
                self.report.unplugged += len(block)
        self._link.plug()

    def _show_signs_of_life(self) -> None:
        now = self._clock()
        if self._greeted != self._link.connections or now >= self._next_hello:
            self._greeted = self._link.connections
            self._next_hello = now + HELLO_S
            self._send(_hello(self._source.array, self._seq, self._now_ns, self._faults.serial_number))
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + HEARTBEAT_S
            self._send(Heartbeat(self._seq, self._now_ns))

    def _send(self, packet: Packet) -> None:
        if not self._link.send(encode(packet)):
            log.debug("nobody took %s", packet)


def damaged(wire: bytes, rng: np.random.Generator) -> bytes:
    """`wire` with some bytes flipped, lost or inserted, anywhere but at its very ends."""
    result = bytearray(wire)
    kind, where = rng.integers(3), int(rng.integers(2, len(wire) - 2))
    if kind == 0:
        result[where] ^= int(rng.integers(1, 256))
    elif kind == 1:
        del result[where : min(where + int(rng.integers(1, 9)), len(wire) - 1)]
    else:
        result[where:where] = rng.bytes(int(rng.integers(1, 9)))
    return bytes(result)


def _hello(array: ArrayGeometry, seq: int, time_ns: int, serial: str) -> Hello:
    return Hello(
        seq,
        time_ns,
        array.antennas,
        array.subcarriers,
        array.carrier_hz,
        array.subcarrier_spacing_hz,
        array.element_spacing_m,
        serial,
        array.elements,
    )
