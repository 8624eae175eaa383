"""What all live devices have in common: coming back after they have gone, gathering frames into blocks."""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.checks import usable
from chachart.sources.frontend.retry import Backoff
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedDevice

log = logging.getLogger(__name__)

MAX_BLOCK_FRAMES = 64
SETTLE_S = 0.3
"""After a simulated device has sent its last, it has arrived within this time."""


class CodecError(ValueError):
    """What came is not what the device sends.

    Attributes
    ----------
    reason
        One word, under which it is counted.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class DeviceGone(Exception):
    """The device, or the way to it, has gone."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One transmission as the array heard it.

    Attributes
    ----------
    ue
        Who transmitted.
    time_ns
        When, nanoseconds since the Unix epoch.
    csi
        complex64 (N_R antennas, N_S subcarriers).
    packet
        A number that all arrays that heard the transmission give it, 0 where there is none.
    """

    ue: int
    time_ns: int
    csi: NDArray[np.complex64]
    packet: int = 0


class Connection(ABC):
    """An open way to a device."""

    @abstractmethod
    def frames(self, timeout: float) -> list[Frame] | None:
        """The frames that what has come completes; None if nothing came within `timeout` seconds.

        Raises
        ------
        DeviceGone
            If the device has gone.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of it. May be called twice."""

    def details(self) -> dict[str, Any]:
        """What a status display may show: plain values."""
        return {}


class DeviceSettings(SourceSettings):
    """What every live device's source is told."""

    retry_max_s: float = Field(5.0, gt=0)
    """Longest wait between two tries to reach a device that has gone; the first is 0.1 s."""


class DeviceSource(Source):
    """Frames of a device that may go and come back.

    Where it has several arrays, a frame holds the antennas of one after the other, and becomes a block each.

    Attributes
    ----------
    facts
        What its frames' phase, delay and amplitude mean.
    simulated
        The simulated device, where the settings ask for one and the source is open.
    """

    facts: ClassVar[CaptureFacts] = CaptureFacts(phase="random", delay="relative")
    settings: DeviceSettings
    simulated: SimulatedDevice | None

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._backoff = Backoff(self.settings.retry_max_s)
        self._connection: Connection | None = None
        self._reconnects = 0
        self._next_seq = 0
        self._made: deque[CsiBlock] = deque()
        self._ended_s: float | None = None
        self.simulated = None

    @classmethod
    def carried_facts(cls, settings: Any) -> CaptureFacts:
        """See `facts`."""
        return cls.facts

    @property
    @abstractmethod
    def where(self) -> str:
        """What the device is called in the log and the status."""

    @abstractmethod
    def _connect(self) -> Connection:
        """Reach the device and have it send.

        Raises
        ------
        SetupError
            If that cannot be.
        """

    @abstractmethod
    def simulate(self, address: Address = ANY_PORT) -> SimulatedDevice | None:
        """The simulated device that the settings ask for, to listen at `address`; None if they ask for none.

        Raises
        ------
        SetupError
            If it cannot listen there.
        """

    def open(self) -> None:
        """Reach the device.

        Raises
        ------
        SetupError
            If it does not answer, or is not what the settings say.
        """
        try:
            self.simulated = self.simulate()
            if self.simulated is not None:
                self.simulated.start()
            self._connection = self._connect()
        except SetupError:
            self.close()
            raise

    def recv(self, timeout: float) -> CsiBlock | None:
        """The frames that have come, as a block, or None if none came within `timeout` seconds.

        Raises
        ------
        EndOfSource
            When a simulated device has sent all its frames.
        """
        if self._made:
            return self._made.popleft()
        deadline = time.monotonic() + timeout
        frames: list[Frame] = []
        while len(frames) < MAX_BLOCK_FRAMES:
            came = self._step(0.0 if frames else max(deadline - time.monotonic(), 0.0))
            frames += came or ()
            if time.monotonic() >= deadline or (frames and not came):
                break
        if not frames and self._finished():
            raise EndOfSource
        self._made.extend(self._blocks(frames))
        return self._made.popleft() if self._made else None

    def close(self) -> None:
        """Let go of the device, and end it if it is simulated."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self.simulated is not None:
            self.simulated.stop()
            self.simulated = None
        self._ended_s = None

    def details(self) -> dict[str, Any]:
        """The device, whether it is reached, how often it was reached again, and what it says of itself."""
        of_device = {} if self._connection is None else self._connection.details()
        connected = self._connection is not None
        return {"device": self.where, "connected": connected, "reconnects": self._reconnects, **of_device}

    def _finished(self) -> bool:
        """Whether nothing will ever come again: a simulated device has played to its end."""
        if self.simulated is None or not self.simulated.ended.is_set():
            return False
        self._ended_s = self._ended_s or time.monotonic()
        return time.monotonic() - self._ended_s >= SETTLE_S

    def _step(self, timeout: float) -> list[Frame] | None:
        if self._connection is None:
            self._reconnect(timeout)
            return None
        try:
            return self._connection.frames(timeout)
        except DeviceGone as error:
            log.warning("%s has gone (%s): trying again until it is back", self.where, error)
            self._connection.close()
            self._connection = None
            self._backoff.failed()
            return None

    def _reconnect(self, timeout: float) -> None:
        wait = self._backoff.wait_s()
        if wait > 0:
            time.sleep(min(wait, timeout))
            return
        try:
            self._connection = self._connect()
        except SetupError as error:
            log.debug("%s", error)
            self._backoff.failed()
            return
        self._backoff.succeeded()
        self._reconnects += 1
        log.info("%s is back", self.where)

    def _blocks(self, frames: list[Frame]) -> Iterator[CsiBlock]:
        """Frames as blocks, one an array; odd ones are rejected."""
        arrays = (self.array, *self.others)
        shape = sum(array.antennas for array in arrays), self.array.subcarriers
        fitting = [frame for frame in frames if frame.csi.shape == shape]
        if len(fitting) < len(frames):
            self.rejected.add("shape", len(frames) - len(fitting))
        if not fitting:
            return
        ue = np.array([frame.ue for frame in fitting], np.uint64)
        time_ns = np.array([frame.time_ns for frame in fitting], np.int64)
        packets = np.array([frame.packet for frame in fitting], np.uint64)
        csi = np.stack([frame.csi for frame in fitting]).astype(np.complex64, copy=False)
        first = 0
        for array in arrays:
            part = csi[:, first : first + array.antennas]
            first += array.antennas
            block = CsiBlock(
                array.name,
                self._next_seq,
                ue,
                time_ns,
                np.ascontiguousarray(part),
                packet=packets if packets.any() else None,
            )
            good = usable(block, self.rejected)
            self._next_seq = block.seq + (0 if good is None else len(good))
            if good is not None:
                yield good


def count(error: CodecError, rejected: Counters) -> None:
    """Count what was not understood, and say why where somebody debugs."""
    rejected.add(error.reason)
    log.debug("%s", error)
