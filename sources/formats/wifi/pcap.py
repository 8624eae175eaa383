"""Packets of pcap and pcapng files: when they came, and where their link layer's bytes are.

pcapng: blocks of type, length, body, length. Read are section headers (byte order), interface descriptions
(link type, resolution of times), enhanced and simple packet blocks; others are passed over by their length.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.wifi.log import gather
from chachart.sources.formats.wifi.walk import Head, walk

MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""The beginnings of pcap files: byte order, and nanoseconds in the second word of a time."""
PCAPNG = b"\x0a\x0d\x0d\x0a"
_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_FILE_HEADER, _PACKET_HEADER = 24, 16
_SECTION, _INTERFACE, _SIMPLE, _ENHANCED = 0x0A0D0D0A, 1, 3, 6
_RESOLUTION = 9
_MOST = 1 << 20
"""No packet is longer than this; a length beyond is damage."""
_NEAR_S = 30 * 86_400


class Packets(NamedTuple):
    """Of each packet the time in ns, the link type, and where its bytes are.

    `cut` says that the file ends within one; `broken` counts places where a length made no sense.
    """

    time_ns: NDArray[np.int64]
    link: NDArray[np.int64]
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    cut: bool
    broken: int


def is_pcap(head: bytes) -> bool:
    """Whether a file that begins with `head` is a pcap or pcapng file."""
    return head[:4] in MAGICS or (head[:4] == PCAPNG and head[8:12] in _ORDERS)


def packets(data: NDArray[np.uint8]) -> Packets:
    """The packets of a file, bytes (N,) for which `is_pcap` holds."""
    if data[:4].tobytes() == PCAPNG:
        return _pcapng(data)
    order, tick_ns = MAGICS[data[:4].tobytes()]
    if len(data) < _FILE_HEADER:
        empty = np.zeros(0, np.int64)
        return Packets(empty, empty, empty, empty, True, 0)

    def heads(at: NDArray[np.int64]) -> NDArray[np.int64]:
        return gather(data, at, _PACKET_HEADER).view(f"{order}u4").astype(np.int64)

    def plausible(at: NDArray[np.int64]) -> NDArray[np.bool_]:
        there = at + _PACKET_HEADER <= len(data)
        some = heads(at[there])
        near = np.abs(some[:, 0] - began) < _NEAR_S
        there[there] = near & (some[:, 2] == some[:, 3]) & (some[:, 2] > 0) & (some[:, 2] < 1 << 16)
        whole = np.zeros(len(at), bool)
        whole[there] = at[there] + _PACKET_HEADER + heads(at[there])[:, 2] <= len(data)
        return whole

    began = int(heads(np.array([_FILE_HEADER]))[0, 0]) if len(data) >= _FILE_HEADER + _PACKET_HEADER else 0
    link = int(data[20:24].view(f"{order}u4")[0]) & 0xFFFF
    head = Head(_PACKET_HEADER, 8, 4, order == ">", least=0, most=_MOST)
    found = walk(data, head, plausible, at=_FILE_HEADER)
    words = heads(found.starts - _PACKET_HEADER)
    times = words[:, 0] * 1_000_000_000 + words[:, 1] * tick_ns
    return Packets(times, np.full(len(times), link), found.starts, found.lengths, found.cut, found.broken)


def _pcapng(data: NDArray[np.uint8]) -> Packets:
    view = np.ascontiguousarray(data).data
    order, at, size = "<", 0, len(view)
    interfaces: list[tuple[int, int]] = []
    rows: list[tuple[int, int, int, int]] = []
    broken = 0
    while at + 12 <= size:
        kind = struct.unpack_from(f"{order}I", view, at)[0]
        if kind == _SECTION:
            order = _ORDERS.get(bytes(view[at + 8 : at + 12]), order)
            interfaces = []
        length = struct.unpack_from(f"{order}I", view, at + 4)[0]
        if length < 12 or length % 4 or length > _MOST:
            broken = 1
            at = size
            break
        if at + length > size:
            break
        body, end = at + 8, at + length - 4
        if kind == _INTERFACE and end - body >= 8:
            link = struct.unpack_from(f"{order}H", view, body)[0]
            interfaces.append((link, _ticks(view[body + 8 : end], order)))
        elif kind == _ENHANCED and end - body >= 20:
            number, high, low, held = struct.unpack_from(f"{order}4I", view, body)
            if number < len(interfaces) and body + 20 + held <= end:
                link, per_second = interfaces[number]
                time_ns = (high << 32 | low) * 1_000_000_000 // per_second
                rows.append((time_ns if time_ns < 1 << 62 else 0, link, body + 20, held))
        elif kind == _SIMPLE and end - body >= 4 and interfaces:
            held = min(struct.unpack_from(f"{order}I", view, body)[0], end - body - 4)
            rows.append((0, interfaces[0][0], body + 4, held))
        at += length
    columns = np.array(rows, np.int64).reshape(-1, 4).T
    return Packets(columns[0], columns[1], columns[2], columns[3], at < size, broken)


def _ticks(options: memoryview, order: str) -> int:
    """Ticks a second by an interface's options; microseconds where they do not say."""
    at = 0
    while at + 4 <= len(options):
        code, length = struct.unpack_from(f"{order}HH", options, at)
        if code == 0:
            break
        if code == _RESOLUTION and length >= 1 and at + 4 < len(options):
            exponent = int(options[at + 4])
            return int(2 ** min(exponent & 0x7F, 62)) if exponent & 0x80 else int(10 ** min(exponent, 18))
        at += 4 + -(-length // 4) * 4
    return 1_000_000
