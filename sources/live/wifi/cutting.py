"""Whole records out of what comes piece by piece; without input or output.

A cutter takes bytes and gives those that a reader of captures can read: it keeps back what is not whole.
"""

from __future__ import annotations

import struct
import time
from collections import OrderedDict
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.counters import Counters

LONGEST_RECORD = 1 << 20
"""Whatever says that it is longer has lost its way."""


class Cutter(Protocol):
    """Takes pieces of a stream, or datagrams, and gives whole records."""

    def feed(self, piece: bytes) -> bytes:
        """The whole records that there are now, in the order in which they came."""


class Whole:
    """Datagrams that are whole records each."""

    def feed(self, piece: bytes) -> bytes:
        """The datagram."""
        return piece


class LengthFirst:
    """A stream of records with their length in front, 16 bits, big-endian: Intel 5300's `log_to_server`.

    A record of a captured packet stays with the record of CSI that follows it, which is of the same frame.
    """

    _PAYLOAD = 0xC1

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, piece: bytes) -> bytes:
        """See `Cutter`."""
        self._waiting += piece
        at = end = 0
        while at + 3 <= len(self._waiting):
            after = at + 2 + int.from_bytes(self._waiting[at : at + 2], "big")
            if after > len(self._waiting):
                break
            at, of_payload = after, self._waiting[at + 2] == self._PAYLOAD
            if not of_payload:
                end = at
        records = bytes(self._waiting[:end])
        del self._waiting[:end]
        return records


class Lines:
    """A stream of lines, among which headings say what the columns of the others are: ESP32.

    The last heading goes in front of the lines that come after it.
    """

    _HEADINGS = b"type,"

    def __init__(self) -> None:
        self._waiting = bytearray()
        self._heading = b""

    def feed(self, piece: bytes) -> bytes:
        """See `Cutter`."""
        self._waiting += piece
        end = self._waiting.rfind(b"\n") + 1
        lines = bytes(self._waiting[:end])
        del self._waiting[:end]
        if len(self._waiting) > LONGEST_RECORD:
            self._waiting.clear()
        before = self._heading
        at = max(lines.rfind(b"\n" + self._HEADINGS) + 1, 0)
        if lines[at : at + len(self._HEADINGS)] == self._HEADINGS:
            self._heading = lines[at : lines.find(b"\n", at) + 1]
        return before + lines if lines else b""


_PCAP_ORDERS = {
    b"\xd4\xc3\xb2\xa1": "<",
    b"\x4d\x3c\xb2\xa1": "<",
    b"\xa1\xb2\xc3\xd4": ">",
    b"\xa1\xb2\x3c\x4d": ">",
}


class PcapStream:
    """A pcap file that is still being written: `tcpdump -U -w -`. Its head goes in front of the packets."""

    _HEAD, _PACKET = 24, 16

    def __init__(self) -> None:
        self._waiting = bytearray()
        self._head = b""

    def feed(self, piece: bytes) -> bytes:
        """See `Cutter`.

        Raises
        ------
        ValueError
            If it is no pcap stream, or a packet cannot be so long.
        """
        self._waiting += piece
        if not self._head:
            if len(self._waiting) < self._HEAD:
                return b""
            self._head = bytes(self._waiting[: self._HEAD])
            del self._waiting[: self._HEAD]
        order = _PCAP_ORDERS.get(self._head[:4])
        if order is None:
            raise ValueError("it does not begin as a pcap file")
        end = 0
        while end + self._PACKET <= len(self._waiting):
            (length,) = struct.unpack_from(f"{order}I", self._waiting, end + 8)
            if length > LONGEST_RECORD:
                raise ValueError(f"a packet of {length} bytes")
            if end + self._PACKET + length > len(self._waiting):
                break
            end += self._PACKET + length
        packets = bytes(self._waiting[:end])
        del self._waiting[:end]
        return self._head + packets if packets else b""


class EthernetPackets:
    """Frames of a network interface, each as a packet of a pcap file, with the file's head in front."""

    _HEAD = struct.pack("<IHHIIII", 0xA1B23C4D, 2, 4, 0, 0, 262_144, 1)

    def __init__(self) -> None:
        self._begun = False

    def feed(self, piece: bytes) -> bytes:
        """See `Cutter`."""
        now = divmod(time.time_ns(), 1_000_000_000)
        packet = struct.pack("<IIII", *now, len(piece), len(piece)) + piece
        begun, self._begun = self._begun, True
        return packet if begun else self._HEAD + packet


class PicoScenesForwarder:
    """Datagrams of PicoScenes' UDP forwarder: a header of 20 bytes, then a frame or a part of one.

    `u32 magic, u16 version, u16 task, u16 index, u16 count, u32 bytes here, u32 bytes in all`, little-endian.

    Parameters
    ----------
    rejected
        Where datagrams that are none are counted, as `datagram`, and frames that never became whole, as
        `incomplete`.
    """

    MAGIC = 0x20150315
    KEPT = 100
    _HEAD = struct.Struct("<IHHHHII")

    def __init__(self, rejected: Counters) -> None:
        self._rejected = rejected
        self._waiting: OrderedDict[int, dict[int, bytes]] = OrderedDict()

    def feed(self, piece: bytes) -> bytes:
        """See `Cutter`."""
        if len(piece) < self._HEAD.size:
            self._rejected.add("datagram")
            return b""
        magic, _, task, index, count, here, total = self._HEAD.unpack_from(piece)
        data = piece[self._HEAD.size :]
        if magic != self.MAGIC or index >= count or here != len(data) or not here <= total <= LONGEST_RECORD:
            self._rejected.add("datagram")
            return b""
        if count == 1:
            return data
        parts = self._waiting.setdefault(task, {})
        parts[index] = data
        if len(parts) == count:
            del self._waiting[task]
            whole = b"".join(parts[i] for i in sorted(parts))
            if len(whole) == total:
                return whole
            self._rejected.add("incomplete")
            return b""
        while len(self._waiting) > self.KEPT:
            self._waiting.popitem(last=False)
            self._rejected.add("incomplete")
        return b""

    @classmethod
    def encode(cls, frame: bytes, task: int, longest: int = 65_000) -> list[bytes]:
        """The datagrams of a frame."""
        parts = [frame[at : at + longest] for at in range(0, len(frame), longest)]
        heads = [
            cls._HEAD.pack(cls.MAGIC, 1, task, i, len(parts), len(part), len(frame))
            for i, part in enumerate(parts)
        ]
        return [head + part for head, part in zip(heads, parts, strict=True)]


class NexmonFrames:
    """Datagrams of Nexmon, one a core and stream, in the order of their frames.

    Networks may swap datagrams: those of the two newest frames are kept back, and one that comes late still
    finds its own.
    """

    _KEPT = 2

    def __init__(self) -> None:
        self._waiting: dict[bytes, list[bytes]] = {}

    def feed(self, piece: bytes) -> list[bytes]:
        """The datagrams of all frames that have ended: when two others have begun after them."""
        self._waiting.setdefault(self._frame(piece), []).append(piece)
        if len(self._waiting) <= self._KEPT:
            return []
        return self._waiting.pop(next(iter(self._waiting)))

    def flush(self) -> list[bytes]:
        """The datagrams of the last frames, when nothing has come for a while."""
        ended = [piece for pieces in self._waiting.values() for piece in pieces]
        self._waiting.clear()
        return ended

    @staticmethod
    def _frame(payload: bytes) -> bytes:
        return payload[4:12]


def joined(pieces: list[bytes]) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]]:
    """Pieces one after the other, where each begins, and how long it is."""
    lengths = np.array([len(piece) for piece in pieces], np.int64)
    starts = np.cumsum(lengths) - lengths
    return np.frombuffer(b"".join(pieces), np.uint8), starts, lengths
