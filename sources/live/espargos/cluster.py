"""From what single antennas say of a Wi-Fi packet to one coherent frame of all of them.

Each sensor finds the beginning of a packet on its own, to a few nanoseconds; by its clock it says where it
took it to be. Turning the phases back by that time, `h[k] exp(-j 2 pi t k spacing)`, makes the sensors agree
up to one delay and one phase each, which `calibration` finds.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.counters import Counters
from chachart.sources.live.espargos.message import SUBCARRIER_SPACING_HZ, TONES, SensorCsi

ANTENNAS = 8
"""Of one board."""
KEPT_S = 0.5
"""A packet that not all antennas have heard within this time is given up."""
KEPT_PACKETS = 256
"""At most so many packets are waited for."""
OFFSET_40_MHZ = 32
"""Subcarriers between the middle of a 20 MHz packet and the radio's own, when it is set to 40 MHz."""

Packet = tuple[int, int, int, bool]


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """One Wi-Fi packet at all antennas of a board or of several.

    Attributes
    ----------
    first
        What the first antenna says: who, when, on which channel.
    csi
        complex64 (antennas, tones) as measured, at unit gain.
    delay_s
        float64 (antennas,): where each sensor took the beginning of the packet to be, against the first.
    """

    first: SensorCsi
    csi: NDArray[np.complex64]
    delay_s: NDArray[np.float64]

    @classmethod
    def of(cls, sensors: list[SensorCsi]) -> Cluster:
        """The messages of all antennas, in their order."""
        first = sensors[0]
        half_ns = np.array([sensor.time_half_ns - first.time_half_ns for sensor in sensors], np.float64)
        return cls(first, np.stack([sensor.csi for sensor in sensors]), half_ns * 0.5e-9)

    def tones(self) -> NDArray[np.float64]:
        """The tones as the radio counts them, from its own middle."""
        return TONES - float(OFFSET_40_MHZ * self.first.secondary)

    def aligned(self) -> NDArray[np.complex64]:
        """The frame (antennas, tones), all sensors as if they had begun with the first."""
        turns = self.delay_s[:, None] * SUBCARRIER_SPACING_HZ * self.tones()
        frame: NDArray[np.complex64] = (self.csi * np.exp(-2j * np.pi * turns)).astype(np.complex64)
        return frame


@dataclass(slots=True)
class _Waiting:
    since_s: float
    sensors: dict[int, SensorCsi] = field(default_factory=dict)


class Grouping:
    """Messages of single antennas in, whole packets out.

    Parameters
    ----------
    antennas
        How many there are.
    rejected
        Where packets that not all antennas heard are counted (`incomplete`), and messages that came twice
        (`duplicate`).
    """

    def __init__(self, antennas: int, rejected: Counters) -> None:
        self._antennas = antennas
        self._rejected = rejected
        self._waiting: dict[Packet, _Waiting] = {}
        self._done: dict[Packet, float] = {}

    def add(self, antenna: int, sensor: SensorCsi, now_s: float) -> Cluster | None:
        """The packet that the message completes, if it does."""
        self.give_up(now_s)
        key = sensor.packet
        if key in self._done:
            self._rejected.add("duplicate")
            return None
        waiting = self._waiting.setdefault(key, _Waiting(now_s))
        if antenna in waiting.sensors:
            self._rejected.add("duplicate")
            return None
        waiting.sensors[antenna] = sensor
        if len(waiting.sensors) < self._antennas:
            return None
        del self._waiting[key]
        self._done[key] = now_s
        return Cluster.of([waiting.sensors[i] for i in range(self._antennas)])

    def give_up(self, now_s: float) -> None:
        """Let go of packets that have waited too long."""
        while self._waiting:  # those that came first are first
            key, waiting = next(iter(self._waiting.items()))
            if now_s - waiting.since_s <= KEPT_S and len(self._waiting) <= KEPT_PACKETS:
                break
            del self._waiting[key]
            self._rejected.add("incomplete")
        while self._done:
            key, done = next(iter(self._done.items()))
            if now_s - done <= KEPT_S:
                break
            del self._done[key]
