"""Packets on a byte stream: COBS between zero bytes, a decoder that finds its way back after any damage.

A sender puts a zero byte before and after each COBS-encoded packet. The one after ends the packet without
delay; the one before keeps a packet whole whose predecessor lost its end.
"""

from __future__ import annotations

from cobs import cobs

from chachart.node.data.counters import Counters


def encode_frame(packet: bytes) -> bytes:
    """`packet` as it goes over a serial line: zero, COBS, zero."""
    return b"".join((b"\0", cobs.encode(packet), b"\0"))


class StreamDecoder:
    """Cuts a byte stream into packets and never holds more than one packet's worth of it.

    Parameters
    ----------
    max_packet_bytes
        Longest packet to expect; anything longer is noise.
    rejected
        Where damage is counted: `cobs` (not COBS), `oversize` (too long a stretch without a zero byte).

    >>> decoder = StreamDecoder(64, Counters())
    >>> decoder.feed(encode_frame(b"ab")[:3]), decoder.feed(encode_frame(b"ab")[3:])
    ([], [b'ab'])
    """

    def __init__(self, max_packet_bytes: int, rejected: Counters) -> None:
        self._limit = cobs.max_encoded_length(max_packet_bytes)
        self._rejected = rejected
        self._partial = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> list[bytes]:
        """The packets that `data` completes, as they came; their content is not looked at."""
        *complete, rest = data.split(b"\0")
        packets = []
        for piece in complete:
            self._hold(piece)
            if self._partial:
                try:
                    packets.append(cobs.decode(self._partial))
                except cobs.DecodeError:
                    self._rejected.add("cobs")
                self._partial.clear()
            self._skipping = False
        self._hold(rest)
        return packets

    def reset(self) -> None:
        """Forget a half packet, as after unplugging."""
        self._partial.clear()
        self._skipping = False

    def _hold(self, piece: bytes) -> None:
        if self._skipping:
            return
        if len(self._partial) + len(piece) > self._limit:
            self._rejected.add("oversize")
            self._partial.clear()
            self._skipping = True
        else:
            self._partial += piece
