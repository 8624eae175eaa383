"""Sensor packets: what an ESPARGOS controller sends in a UDP datagram, a WebSocket message or a UART frame.

`u32 0xDECAFBAD`, then fragments of `u32 uid, u16 size, u8 index, u8 total` and `size` bytes each, ended by a
header whose uid is 0. The top three bits of a uid are the antenna, the rest a number that tells messages
apart. Little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from chachart.node.data.counters import Counters
from chachart.sources.live.device import CodecError

MAGIC = 0xDECAFBAD
HELLO = bytes.fromhex("e5a76000")
"""The first datagram of a UDP stream."""
KEPT_S = 5.0
"""A message whose fragments do not come within this time is given up."""
KEPT_MESSAGES = 1024
"""At most so many messages are waited for."""

_HEAD = struct.Struct("<I")
_FRAGMENT = struct.Struct("<IHBB")


@dataclass(frozen=True, slots=True)
class Fragment:
    """Part `index` of the `total` parts of message `uid`."""

    uid: int
    index: int
    total: int
    data: bytes

    @property
    def antenna(self) -> int:
        """Which of the board's eight antennas heard it."""
        return self.uid >> 29


def encode_packet(fragments: list[Fragment]) -> bytes:
    """A sensor packet of these fragments."""
    parts = [_HEAD.pack(MAGIC)]
    for fragment in fragments:
        parts += [
            _FRAGMENT.pack(fragment.uid, len(fragment.data), fragment.index, fragment.total),
            fragment.data,
        ]
    return b"".join([*parts, _FRAGMENT.pack(0, 0, 0, 0)])


def decode_packet(packet: bytes) -> Iterator[Fragment]:
    """The fragments of a sensor packet, those before a damaged place included.

    Raises
    ------
    CodecError
        `magic` if it is none, `truncated` if it ends early, `fragment` if a fragment's numbers cannot be.
    """
    if len(packet) < _HEAD.size or _HEAD.unpack_from(packet)[0] != MAGIC:
        raise CodecError("magic", "a sensor packet begins with 0xDECAFBAD")
    at = _HEAD.size
    while at + 4 <= len(packet):
        if _HEAD.unpack_from(packet, at)[0] == 0:
            return
        if at + _FRAGMENT.size > len(packet):
            break
        uid, size, index, total = _FRAGMENT.unpack_from(packet, at)
        at += _FRAGMENT.size
        if index >= total:
            raise CodecError("fragment", f"fragment {index} of {total}")
        if at + size > len(packet):
            break
        yield Fragment(uid, index, total, packet[at : at + size])
        at += size
    raise CodecError("truncated", "a sensor packet ends with an empty fragment")


@dataclass(slots=True)
class _Waiting:
    total: int
    since_s: float
    parts: dict[int, bytes] = field(default_factory=dict)


class Reassembly:
    """Fragments in, whole messages out.

    Parameters
    ----------
    rejected
        Where messages that never became whole are counted, as `incomplete_message`.
    """

    def __init__(self, rejected: Counters) -> None:
        self._rejected = rejected
        self._waiting: dict[int, _Waiting] = {}

    def add(self, fragment: Fragment, now_s: float) -> bytes | None:
        """The message that the fragment completes, if it does."""
        if fragment.total == 1:
            return fragment.data
        self._give_up(now_s)
        waiting = self._waiting.get(fragment.uid)
        if waiting is None or waiting.total != fragment.total:
            if waiting is not None:
                self._rejected.add("incomplete_message")
            waiting = self._waiting[fragment.uid] = _Waiting(fragment.total, now_s)
        waiting.parts[fragment.index] = fragment.data
        if len(waiting.parts) < waiting.total:
            return None
        del self._waiting[fragment.uid]
        return b"".join(waiting.parts[i] for i in range(waiting.total))

    def _give_up(self, now_s: float) -> None:
        late = [uid for uid, waiting in self._waiting.items() if now_s - waiting.since_s > KEPT_S]
        late += list(self._waiting)[: max(len(self._waiting) - len(late) - KEPT_MESSAGES, 0)]
        for uid in dict.fromkeys(late):
            del self._waiting[uid]
            self._rejected.add("incomplete_message")
