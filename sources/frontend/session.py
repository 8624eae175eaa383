"""What the node knows of a front-end while it listens: who it is, what was lost, how its clock runs."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.checks import usable
from chachart.sources.frontend.clock import DeviceClock
from chachart.sources.frontend.packet import CsiPacket, Heartbeat, Hello, PacketError, decode

log = logging.getLogger(__name__)

WINDOW = 1024
"""A frame so much older than the newest is still taken as late; beyond, the device has restarted."""
ELEMENT_TOLERANCE = 0.02
"""Elements so many wavelengths from where they should be are another array's."""
_CAME_WHOLE = ("duplicate", "array_mismatch", "shape", "all_zero", "non_finite")
"""Reasons of packets that are no usable frame, but whose number was read."""
_MODULUS = 1 << 32
_HALF = 1 << 31


class SequenceTracker:
    """Counts what is lost, late and double in a front-end's sequence numbers (32 bits, wrapping).

    Attributes
    ----------
    lost, duplicates, reordered, restarts
        Frames that never came (so far), that came twice, that came late; and how often counting began anew.
    """

    def __init__(self) -> None:
        self.lost = self.duplicates = self.reordered = self.restarts = 0
        self._next: int | None = None
        self._missing: dict[int, None] = {}

    def accept(self, seq: int) -> bool:
        """Whether CSI packet `seq` is new."""
        ahead = 0 if self._next is None else (seq - self._next) % _MODULUS
        if self._next is None or ahead < _HALF:
            self._skip(ahead)
            self._next = (seq + 1) % _MODULUS
            return True
        if _MODULUS - ahead > WINDOW:
            self.restart(seq + 1)
            return True
        if seq in self._missing:
            del self._missing[seq]
            self.lost -= 1
            self.reordered += 1
            return True
        self.duplicates += 1
        return False

    def announce(self, seq: int) -> bool:
        """The device says that its next CSI packet is `seq`; False if that goes back."""
        ahead = 0 if self._next is None else (seq - self._next) % _MODULUS
        if ahead >= _HALF:
            return False
        self._skip(ahead)
        self._next = seq
        return True

    def restart(self, seq: int) -> None:
        """Count on from `seq`."""
        self.restarts += 1
        self._next = seq % _MODULUS
        self._missing.clear()

    def _skip(self, n: int) -> None:
        if n == 0 or self._next is None:
            return
        self.lost += n
        for seq in range(self._next + max(0, n - WINDOW), self._next + n):
            self._missing[seq % _MODULUS] = None
        while len(self._missing) > WINDOW:
            del self._missing[next(iter(self._missing))]


class Session:
    """One front-end: packets in, frames of the right shape out.

    Parameters
    ----------
    array
        What it should measure.
    rejected
        Where packets that are no usable frame are counted, by reason.
    name
        What the log calls it.
    """

    def __init__(self, array: ArrayGeometry, rejected: Counters, name: str) -> None:
        self.sequence = SequenceTracker()
        self.clock = DeviceClock()
        self._array = array
        self._rejected = rejected
        self._name = name
        self._hello: Hello | None = None
        self._mismatches: list[str] = []
        self._frames = 0
        self._heard_ns: int | None = None

    def receive(self, raw: bytes | bytearray, host_ns: int) -> tuple[int, CsiPacket] | None:
        """Take a packet that arrived at `host_ns`: the frame in it and its host time, or None."""
        try:
            packet = decode(raw)
        except PacketError as error:
            self._rejected.add(error.reason)
            return None
        self._heard_ns = host_ns
        if isinstance(packet, CsiPacket):
            return self._frame(packet, host_ns)
        if isinstance(packet, Hello):
            self._greet(packet)
        elif isinstance(packet, Heartbeat):
            self.sequence.announce(packet.seq)
        return None

    def details(self) -> dict[str, Any]:
        """Counts, clock and identity: plain values."""
        s = self.sequence
        known = {"serial": self._hello.serial} if self._hello else {}
        return {
            **known,
            "frames": self._frames,
            "lost": s.lost,
            "duplicates": s.duplicates,
            "reordered": s.reordered,
            "restarts": s.restarts,
            "clock": self.clock.details(),
            **({"mismatches": self._mismatches} if self._mismatches else {}),
            **({} if self._heard_ns is None else {"heard_ns": self._heard_ns}),
        }

    def _frame(self, packet: CsiPacket, host_ns: int) -> tuple[int, CsiPacket] | None:
        if not self.sequence.accept(packet.seq):
            self._rejected.add("duplicate")
        elif self._mismatches:
            self._rejected.add("array_mismatch")
        elif packet.samples.shape[:2] != (self._array.antennas, self._array.subcarriers):
            self._rejected.add("shape")
        else:
            self._frames += 1
            return self.clock.observe(packet.time_ns, host_ns), packet
        return None

    def _greet(self, hello: Hello) -> None:
        if not self.sequence.announce(hello.seq):
            self.sequence.restart(hello.seq)
            self.clock = DeviceClock()
        if self._hello is None or hello.serial != self._hello.serial:
            log.info("%s: front-end %s", self._name, hello.serial or "without a serial number")
        mismatches = _mismatches(hello, self._array)
        if mismatches and mismatches != self._mismatches:
            log.warning(
                "%s: front-end %s does not measure what [array] says (%s); its frames are rejected",
                self._name,
                hello.serial,
                "; ".join(mismatches),
            )
        self._hello, self._mismatches = hello, mismatches


class Intake:
    """Frames of all front-ends on one link, gathered into blocks.

    The `seq` of every block but the first counts the lost frames too, so that who reads it sees the gap.
    Frames that came damaged are among the rejected, not in a gap as well: as many as were damaged since the
    take before the last.
    """

    def __init__(self, array: ArrayGeometry, rejected: Counters) -> None:
        self.sessions: dict[str, Session] = {}
        self._array = array
        self._rejected = rejected
        self._times: list[int] = []
        self._packets: list[CsiPacket] = []
        self._delivered = 0
        self._missing = 0
        self._lost = self._damaged = self._damaged_before = 0

    def receive(self, name: str, raw: bytes | bytearray, host_ns: int) -> None:
        """Take a packet of the front-end called `name` that arrived at `host_ns`."""
        if name not in self.sessions:
            self.sessions[name] = Session(self._array, self._rejected, name)
        frame = self.sessions[name].receive(raw, host_ns)
        if frame is not None:
            self._times.append(frame[0])
            self._packets.append(frame[1])

    def __len__(self) -> int:
        return len(self._packets)

    def take(self) -> CsiBlock | None:
        """All usable frames since the last call as one block, or None if there are none."""
        if not self._packets:
            return None
        packets, times = self._packets, self._times
        self._packets, self._times = [], []
        self._look_for_gaps()
        seq = self._delivered + self._missing if self._delivered else 0
        scale = np.array([p.scale for p in packets], np.float32)
        pairs = np.stack([p.samples for p in packets]).astype(np.float32, copy=False)
        with np.errstate(over="ignore"):
            pairs *= scale[:, None, None, None]
        block = CsiBlock(
            array=self._array.name,
            seq=seq,
            ue=np.array([p.ue for p in packets], np.uint64),
            time_ns=np.array(times, np.int64),
            csi=pairs.view(np.complex64)[..., 0],
        )
        good = usable(block, self._rejected)
        self._delivered += 0 if good is None else len(good)
        return good

    def _look_for_gaps(self) -> None:
        """Count frames that are missing, but for those of which something damaged came."""
        counts = self._rejected.as_dict()
        damaged = sum(n for reason, n in counts.items() if reason not in _CAME_WHOLE)
        lost = sum(s.sequence.lost for s in self.sessions.values())
        newly_lost, newly_damaged = lost - self._lost, damaged - self._damaged
        came_damaged = min(max(newly_lost, 0), self._damaged_before + newly_damaged)
        self._missing += max(newly_lost - came_damaged, 0)
        self._damaged_before = max(newly_damaged - came_damaged, 0)
        self._lost, self._damaged = max(lost, self._lost), damaged

    def details(self) -> dict[str, Any]:
        """By front-end: counts, clock and identity."""
        return {"front_ends": {name: session.details() for name, session in list(self.sessions.items())}}


def _mismatches(hello: Hello, array: ArrayGeometry) -> list[str]:
    pairs = [
        (name, getattr(hello, name), getattr(array, name))
        for name in ("antennas", "subcarriers", "carrier_hz", "subcarrier_spacing_hz", "element_spacing_m")
        if name != "element_spacing_m" or hello.element_spacing_m
    ]
    wrong = [
        f"{name} = {theirs:g}, not {ours:g}" for name, theirs, ours in pairs if abs(theirs / ours - 1) > 1e-6
    ]
    if hello.elements is not None and hello.antennas == array.antennas:
        theirs = np.array(hello.elements)
        off = np.linalg.norm(theirs - theirs.mean(axis=0) - array.own_elements, axis=1)
        if off.max() > ELEMENT_TOLERANCE * array.wavelength_m:
            wrong.append(
                f"element {int(off.argmax())} is {1000 * off.max():.1f} mm from where [array] has it"
            )
    return wrong
