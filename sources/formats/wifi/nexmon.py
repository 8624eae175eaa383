"""Captures of nexmon_csi on Broadcom chips (`.pcap`, `.pcapng`).

One UDP packet has the CSI of one core (that is one antenna) and one spatial stream; those of a received frame
follow one another with the same sender and sequence number, and a core that comes again begins the next
frame. A payload is 18 bytes, 0x1111 first, then one word of 32 bits a subcarrier in the order of the FFT.
Chips bcm4339 and bcm43455c0 write 16-bit integers, bcm4358 and bcm4366c0 floating-point numbers of their own,
which leave the highest bits of a word free: so the words tell which it is.

The firmware overwrites three words of each packet; they, the guards and the middle do not count.
"""

from __future__ import annotations

from collections import Counter
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.wifi import tones
from chachart.sources.formats.wifi.bits import complex_of_16
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.log import Group, Kind, Log, Tones, address, gather, merged, split
from chachart.sources.formats.wifi.pcap import is_pcap, packets

NAME = "Nexmon .pcap"

_BLOCK = 1024
HEADER = 18
_CORE = 12
"""Bytes of a payload in front of the CSI."""
_MAGIC = 0x11
_LINK_BYTES = {1: 14, 12: 0, 14: 0, 101: 0, 113: 16, 228: 0, 276: 20}
"""Bytes in front of the IP header by link type: Ethernet, raw IP, Linux cooked (two versions)."""
_UDP, _UDP_HEADER = 17, 8
_SIZES = (64, 128, 256, 512)
_SPACING_HZ = tones.SPACING_HZ
_USED = {64: ("ht", 20), 128: ("ht", 40), 256: ("vht", 80), 512: ("vht", 160)}
_OVERWRITTEN = {64: (28, 29, 30)}
"""Words of a packet that hold the state of the receiver instead; elsewhere the first three."""


class Numbers(NamedTuple):
    """A chip's numbers: bits of mantissa (with sign) and exponent; without exponent, 16-bit integers."""

    mantissa: int
    exponent: int


INTEGERS, BCM4358, BCM4366C0 = Numbers(16, 0), Numbers(9, 5), Numbers(12, 6)
_FREE = ((BCM4358, 23), (BCM4366C0, 30))
"""Chips, and the bit from which on their words have zeros only."""


class Payloads(NamedTuple):
    """UDP payloads of Nexmon: where their bytes begin, how many there are, when they came (ns)."""

    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    time_ns: NDArray[np.int64]


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    return None if is_pcap(head) else "it is no pcap file"


def open_capture(path: Path) -> WifiCapture:
    """The CSI of a capture; `csi_4358` and `csi_4366c0` insist on these chips' numbers.

    Raises
    ------
    SetupError
        If the capture cannot be read or has no CSI.
    """
    ways = {"csi_4358": partial(read, numbers=BCM4358), "csi_4366c0": partial(read, numbers=BCM4366C0)}
    return WifiCapture(path, NAME, read, ("ue", "antenna", "subcarrier"), ways)


def read(data: NDArray[np.uint8], numbers: Numbers | None = None) -> Log:
    """The frames of a pcap or pcapng file, bytes (N,)."""
    found = packets(data)
    left_out: Counter[str] = Counter()
    if found.broken:
        left_out["broken record"] = found.broken
    if found.cut:
        left_out["cut short"] = 1
    log = read_payloads(
        data, _payloads(data, found.link, found.starts, found.lengths, found.time_ns), numbers
    )
    log.left_out += left_out
    return log


def is_payload(payload: bytes) -> bool:
    """Whether a UDP payload has the CSI of a core and stream."""
    count, rest = divmod(len(payload) - HEADER, 4)
    return rest == 0 and count in _SIZES and payload[:2] == bytes([_MAGIC, _MAGIC])


def read_payloads(
    data: NDArray[np.uint8],
    found: Payloads,
    numbers: Numbers | None = None,
    heard_by: set[int] | None = None,
) -> Log:
    """The frames of UDP payloads that follow one another in time, in bytes (N,).

    `numbers` says how the chip writes, and `heard_by` which cores a whole frame has; where they are not
    given, the words tell, and the payloads.
    """
    count = (found.lengths - HEADER) // 4
    good = (found.lengths > HEADER) & np.isin(count, _SIZES)
    good[good] = (gather(data, found.starts[good], 2) == _MAGIC).all(axis=1)
    starts, count, times = found.starts[good], count[good], found.time_ns[good]
    header = gather(data, starts, HEADER)
    words = np.ascontiguousarray(header[:, 10:]).view("<u2")
    core, stream = words[:, 1].astype(np.int64) & 7, words[:, 1].astype(np.int64) >> 3 & 7
    unit = 8 * core + stream
    frame = _frames(header, unit, count)
    whole = np.zeros(int(frame[-1]) + 1 if len(frame) else 0, np.int64)
    np.add.at(whole, frame, 1)
    first = np.cumsum(whole) - whole
    streams = np.zeros(len(whole), np.int64)
    np.maximum.at(streams, frame, stream + 1)
    cores = {
        int(size): usual_cores(np.bincount(core[count == size])) if heard_by is None else heard_by
        for size in np.unique(count)
    }
    amount = np.array([len(cores[int(count[row])]) for row in first], np.int64)
    complete = whole == amount * streams
    for row in np.flatnonzero(complete & (amount > 1)).tolist():
        complete[row] = set(core[first[row] : first[row] + whole[row]]) == cores[int(count[first[row]])]
    if numbers is None:
        numbers = _numbers(data, starts, count)
    number = np.flatnonzero(complete)
    rows = first[number]
    keys = np.column_stack([count[rows] >> 5, streams[number], words[rows, 2] & 255, words[rows, 2] >> 8])
    groups = [
        _group(
            data,
            starts,
            header,
            times,
            int(count[rows[part[0]]]),
            number[part],
            first[number[part]],
            np.argsort(unit[rows[part][:, None] + np.arange(whole[number[part[0]]])], axis=1, kind="stable"),
            len(cores[int(count[rows[part[0]]])]),
            numbers,
        )
        for part in split(keys)
    ]
    left_out = Counter({"incomplete": int(np.count_nonzero(~complete))} if not complete.all() else {})
    return Log(
        merged(groups),
        left_out,
        "time of the packet in the pcap file",
        has_senders=True,
        order=("bandwidth_hz", "shape", "channel"),
    )


def _payloads(
    data: NDArray[np.uint8],
    link: NDArray[np.int64],
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
    time_ns: NDArray[np.int64],
) -> Payloads:
    """The UDP payloads of packets; what stands behind the end that their headers tell does not count."""
    before = np.full(len(link), -1, np.int64)
    for kind, octets in _LINK_BYTES.items():
        before[link == kind] = octets
    at = np.flatnonzero((before >= 0) & (lengths >= before + 20 + _UDP_HEADER))
    start, room, when = starts[at] + before[at], (lengths - before)[at], time_ns[at]
    head = gather(data, start, 20).astype(np.int64)
    size = 4 * (head[:, 0] & 15)
    good = (head[:, 0] >> 4 == 4) & (head[:, 9] == _UDP) & (size >= 20) & (size + _UDP_HEADER <= room)
    start, size, room, head, when = (a[good] for a in (start, size, room, head, when))
    udp = gather(data, start + size, _UDP_HEADER).astype(np.int64)
    told = np.minimum(udp[:, 4] * 256 + udp[:, 5], head[:, 2] * 256 + head[:, 3] - size)
    return Payloads(start + size + _UDP_HEADER, np.minimum(told, room - size) - _UDP_HEADER, when)


def _frames(
    header: NDArray[np.uint8], unit: NDArray[np.int64], count: NDArray[np.int64]
) -> NDArray[np.int64]:
    """For each packet, which frame it is of."""
    if not len(header):
        return np.zeros(0, np.int64)
    if (unit == unit[0]).all():
        return np.arange(len(unit), dtype=np.int64)
    key = np.column_stack([header[:, 4:12], count.astype(np.int64).view(np.uint8).reshape(-1, 8)[:, :2]])
    fresh = np.append(True, (key[1:] != key[:-1]).any(axis=1))
    seen = 0
    for n, (new, which) in enumerate(zip(fresh.tolist(), (1 << unit).tolist(), strict=True)):
        if new or seen & which:
            fresh[n], seen = True, 0
        seen |= which
    return np.cumsum(fresh) - 1


def core_of(payload: bytes) -> int:
    """The core that a payload is of."""
    return payload[_CORE] & 7


def usual_cores(packets: NDArray[Any]) -> set[int]:
    """Of so many packets of each core: those with at least a quarter as many as the commonest."""
    return set(np.flatnonzero(4 * packets >= packets.max()).tolist())


def _group(
    data: NDArray[np.uint8],
    starts: NDArray[np.int64],
    header: NDArray[np.uint8],
    times: NDArray[np.int64],
    size: int,
    number: NDArray[np.int64],
    first: NDArray[np.int64],
    order: NDArray[np.int64],
    cores: int,
    numbers: Numbers,
) -> Group:
    """Frames whose packets are `first + order`, (F, cores x streams), ordered by core, then by stream."""
    head = header[first]
    chanspec = int(head[0, 14]) | int(head[0, 15]) << 8
    packet = first[:, None] + order
    streams = packet.shape[1] // cores
    csi = np.empty((len(first), cores * streams, size), np.complex64)
    half = size // 2
    for first_row in range(0, len(first), _BLOCK):
        block = slice(first_row, first_row + _BLOCK)
        for place in range(packet.shape[1]):
            raw = gather(data, starts[packet[block, place]] + HEADER, 4 * size).view("<u4")
            values = _decoded(raw, numbers)
            csi[block, place, half:], csi[block, place, :half] = values[:, :half], values[:, half:]
    channel = chanspec & 255
    band = {0: 2, 3: 5, 2: 6}.get(chanspec >> 14)
    kind = Kind(
        cores,
        streams,
        size,
        _tones(size),
        carrier_hz=tones.channel_hz(channel, band),
        bandwidth_hz=size * _SPACING_HZ,
        channel=chanspec,
    )
    columns = {"time": times[first], "ue": address(head[:, 4:10])}
    rssi = np.ascontiguousarray(head[:, 2]).view(np.int8)
    # Before this field was added, its byte and the next were part of the magic number.
    said = ~((head[:, 2] == _MAGIC) & (head[:, 3] == _MAGIC)) & (rssi < 0)
    if said.any():
        columns["rssi_dbm"] = np.where(said, rssi, np.nan).astype(np.float32)
        columns["rssi"] = rssi[:, None].astype(np.int16)
    return Group(kind, number, csi.reshape(len(first), cores, streams, size), columns)


@cache
def _tones(size: int) -> Tones:
    numbers = tuple(range(-size // 2, size // 2))
    used = tones.carrying(*_USED[size])
    overwritten = _OVERWRITTEN.get(size, (0, 1, 2))
    return Tones(numbers, used, tuple(n for n in overwritten if n in used))


def _numbers(data: NDArray[np.uint8], starts: NDArray[np.int64], count: NDArray[np.int64]) -> Numbers:
    """How the chip writes, by the bits that are zero in all words."""
    found = np.uint32(0)
    for size in np.unique(count).tolist():
        some = starts[count == size][:256]
        found |= np.bitwise_or.reduce(gather(data, some + HEADER, 4 * size).view("<u4"), axis=None)
    return next((numbers for numbers, free in _FREE if int(found) >> free == 0), INTEGERS)


def _decoded(words: NDArray[np.uint32], numbers: Numbers) -> NDArray[np.complex64]:
    """complex64 of words (F, subcarriers)."""
    if not numbers.exponent:
        return complex_of_16(words)
    values = np.empty(words.shape, np.complex64)
    man, exp = numbers
    exponent = (words & ((1 << exp) - 1)).astype(np.int32)
    exponent -= (exponent >> (exp - 1)) << exp
    largest = np.uint32((1 << (man - 1)) - 1)
    for part, low in (("imag", exp), ("real", exp + man)):
        size = (words >> low & largest).astype(np.float32)
        sign = np.where(words >> (low + man - 1) & 1, np.float32(-1), np.float32(1))
        setattr(values, part, np.ldexp(sign * size, exponent))
    return values
