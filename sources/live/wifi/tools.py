"""The Wi-Fi tools that can be listened to: how their records come, and who reads them."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.counters import Counters
from chachart.sources.formats.wifi import esp32, feitcsi, intel5300, nexmon, picoscenes
from chachart.sources.formats.wifi.log import Log
from chachart.sources.live.device import CodecError
from chachart.sources.live.wifi import openwifi
from chachart.sources.live.wifi.cutting import (
    Cutter,
    EthernetPackets,
    LengthFirst,
    Lines,
    NexmonFrames,
    PcapStream,
    PicoScenesForwarder,
    Whole,
    joined,
)

ToolName = Literal["nexmon", "nexmon_pcap", "picoscenes", "feitcsi", "intel5300", "esp32", "openwifi"]
ChipName = Literal["integers", "bcm4358", "bcm4366c0"]
CHIPS = {"integers": nexmon.INTEGERS, "bcm4358": nexmon.BCM4358, "bcm4366c0": nexmon.BCM4366C0}
CORES, REMEMBERED_PAYLOADS = 8, 200
"""A datagram that says a wrong core must not make whole frames look as if they lacked one."""
_MICROSECOND_NS = 1000


class Decoder(ABC):
    """Pieces in, logs out."""

    @abstractmethod
    def feed(self, pieces: list[bytes]) -> list[Log]:
        """What the records say that these pieces complete.

        No pieces mean that nothing has come for a while.

        Raises
        ------
        CodecError
            If the pieces are nothing of this tool's, and nothing that follows will be.
        """


class RecordDecoder(Decoder):
    """Records that a reader of captures reads as they are."""

    def __init__(self, cutter: Cutter, read: Callable[[NDArray[np.uint8]], Log]) -> None:
        self._cutter, self._read = cutter, read

    def feed(self, pieces: list[bytes]) -> list[Log]:
        """See `Decoder`."""
        try:
            records = [found for piece in pieces if (found := self._cutter.feed(piece))]
        except ValueError as error:
            raise CodecError("stream", str(error)) from None
        # One by one: a datagram that is cut must not spoil the next.
        return [self._read(np.frombuffer(found, np.uint8)) for found in records]


class NexmonDecoder(Decoder):
    """Datagrams of Nexmon, a core and stream each."""

    def __init__(self, chip: ChipName, rejected: Counters) -> None:
        self._numbers, self._rejected = CHIPS[chip], rejected
        self._frames = NexmonFrames()
        self._heard = np.zeros(CORES)

    def feed(self, pieces: list[bytes]) -> list[Log]:
        """See `Decoder`."""
        good = [piece for piece in pieces if nexmon.is_payload(piece)]
        if len(good) < len(pieces):
            self._rejected.add("datagram", len(pieces) - len(good))
        ended = [payload for piece in good for payload in self._frames.feed(piece)]
        if not pieces:
            ended = self._frames.flush()
        if not ended:
            return []
        for payload in ended:
            self._heard *= 1 - 1 / REMEMBERED_PAYLOADS
            self._heard[nexmon.core_of(payload)] += 1
        data, starts, lengths = joined(ended)
        now = time.time_ns() + _MICROSECOND_NS * np.arange(len(ended), dtype=np.int64)
        payloads = nexmon.Payloads(starts, lengths, now)
        return [nexmon.read_payloads(data, payloads, self._numbers, nexmon.usual_cores(self._heard))]


def decoder(
    tool: ToolName, chip: ChipName, equalisers: int, rejected: Counters, *, ethernet: bool = False
) -> Decoder:
    """The decoder of a tool's records; `ethernet` says that pieces are frames of a network interface."""
    match tool:
        case "nexmon":
            return NexmonDecoder(chip, rejected)
        case "nexmon_pcap":
            return RecordDecoder(
                EthernetPackets() if ethernet else PcapStream(), partial(nexmon.read, numbers=CHIPS[chip])
            )
        case "picoscenes":
            return RecordDecoder(PicoScenesForwarder(rejected), picoscenes.read)
        case "feitcsi":
            return RecordDecoder(Whole(), feitcsi.read)
        case "intel5300":
            return RecordDecoder(LengthFirst(), intel5300.read)
        case "esp32":
            return RecordDecoder(Lines(), esp32.read)
        case "openwifi":
            return RecordDecoder(Whole(), partial(openwifi.read, equalisers=equalisers))
