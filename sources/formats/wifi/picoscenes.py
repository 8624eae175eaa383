"""Captures of PicoScenes (`.csi`) from Intel 5300, AX200 and AX210, Atheros QCA9300 and USRP.

A frame is its length, a number that says PicoScenes, and named segments with a version each; the packet
itself follows. Read are `RxSBasic` (versions 1 to 5), `CSI` (1 to 6), the card's clock in `MVMExtra`, and the
sender's address in the packet. Subcarriers are those of the file; pilots, which are weak in AX200 and
AX210, are kept and marked.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.clock import unwrapped
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.log import Group, Log, address, gather, merged, split
from chachart.sources.formats.wifi.picoscenes_csi import (
    AX200,
    AX210,
    USRP,
    decoded,
    device_of,
    header_bytes,
)
from chachart.sources.formats.wifi.walk import Head, walk

NAME = "PicoScenes .csi"

_MAGIC = np.frombuffer(b"\x15\x03\x15\x20", np.uint8)
_LENGTH, _HEADER = 4, 11
"""Bytes of a frame's length, and of its header with the length."""
_RSSI = {1: 22, 2: 24, 3: 28, 4: 36, 5: 38}
"""Where RxSBasic has RSSI of the whole and then of each chain, by version; the noise is in front of it."""
_BASIC_BYTES = {1: 26, 2: 28, 3: 32, 4: 40, 5: 47}
_WITH_SYSTEM_TIME = 4
"""The first version of RxSBasic that has the computer's time besides the device's."""
_CARD_CLOCK = slice(90, 94)
"""Microseconds of the card in MVMExtra."""
_SENDER = slice(10, 16)
_MOST_LAYOUTS = 64
"""So many arrangements of segments are read in bulk; the frames of further ones are read one by one."""
_MOST_SEGMENTS = 64


class _Segment(NamedTuple):
    version: int
    start: int
    stop: int


class _Layout(NamedTuple):
    """How a frame is arranged: its segments, where the packet begins, and which bytes say so."""

    segments: dict[bytes, _Segment]
    packet: int
    packet_has_length: bool
    fixed: NDArray[np.int64]


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    return None if head[4:8] == _MAGIC.tobytes() else "its first frame has not PicoScenes' number"


def open_capture(path: Path) -> WifiCapture:
    """The CSI of a capture; frames without a CSI segment do not count.

    Raises
    ------
    SetupError
        If the capture cannot be read or has no CSI.
    """
    return WifiCapture(path, NAME, read)


def read(data: NDArray[np.uint8]) -> Log:
    """The frames of a file, or of what was joined of UDP datagrams, bytes (N,)."""

    def plausible(at: NDArray[np.int64]) -> NDArray[np.bool_]:
        found = at + _HEADER <= len(data)
        found[found] = (data[at[found][:, None] + 4 + np.arange(4)] == _MAGIC).all(axis=1)
        some = at[found]
        length = gather(data, some, _LENGTH).view("<u4")[:, 0].astype(np.int64)
        found[found] = some + _LENGTH + length <= len(data)
        return found

    walked = walk(data, Head(_LENGTH, 0, _LENGTH, big_endian=False, least=_HEADER - _LENGTH), plausible)
    starts, lengths = walked.starts - _LENGTH, walked.lengths + _LENGTH
    left_out: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    waiting = np.arange(len(starts))
    parts: list[tuple[_Layout, NDArray[np.int64]]] = []
    broken: list[NDArray[np.int64]] = []
    while len(waiting):
        first = int(waiting[0])
        layout = _layout(data[starts[first] : starts[first] + lengths[first]].tobytes())
        if layout is None:
            broken.append(waiting[:1])
            waiting = waiting[1:]
            continue
        same = np.arange(len(waiting)) == 0
        if len(parts) < _MOST_LAYOUTS:
            same = _alike(data, starts[waiting], lengths[waiting], starts[first], layout)
        parts.append((layout, waiting[same]))
        waiting = waiting[~same]
    silent = np.zeros(len(starts), bool)
    for layout, rows in parts:
        silent[rows] = b"CSI" not in layout.segments
    number = np.cumsum(~silent) - 1
    columns = _Columns(len(starts))
    groups: list[tuple[Group, NDArray[np.int64]]] = []
    for layout, rows in parts:
        if b"CSI" in layout.segments:
            bad = _read_part(data, starts, lengths, layout, rows, columns, groups, reasons)
            broken.append(bad)
    lost = sum(map(len, broken)) + walked.broken
    if lost:
        left_out["broken record"] = lost
    if walked.cut:
        left_out["cut short"] = 1
    clock = columns.finish()
    whole = [
        Group(
            group.kind,
            number[rows],
            group.csi,
            {name: values[rows] for name, values in columns.table.items()},
        )
        for group, rows in groups
    ]
    for group in whole:
        group.columns["rssi"] = group.columns["rssi"][:, : 1 + group.kind.antennas]
    remarks = [f"{count} frames: {reason}" for reason, count in reasons.items()]
    if silent.any():
        remarks.append(f"{int(silent.sum())} frames without CSI")
    order = ("shape", "antenna_names", "carrier_hz", "tones", "packet_format")
    return Log(merged(whole), left_out, clock, columns.has_senders, order, remarks)


class _Columns:
    """What each of `count` frames says besides its CSI."""

    def __init__(self, count: int) -> None:
        self.system_ns = np.zeros(count, np.int64)
        self.device_ns = np.zeros(count, np.int64)
        self.card_us = np.zeros(count, np.int64)
        self.seen = np.zeros(count, bool)
        self.usrp = False
        self.has_senders = False
        self.table: dict[str, NDArray[Any]] = {
            "ue": np.zeros(count, np.uint64),
            "rssi": np.zeros((count, 9), np.int16),
            "noise": np.zeros(count, np.int16),
            "rssi_dbm": np.full(count, np.nan, np.float32),
        }

    def finish(self) -> str:
        """Decide which clock counts, and say which."""
        self.table["timestamp"] = self.device_ns
        seen = self.seen
        if seen.any() and (self.system_ns[seen] > 0).all():
            self.table["time"] = self.system_ns
            return "computer's clock (systemTime)"
        if seen.any() and (self.card_us[seen] > 0).all():
            times = np.zeros(len(seen), np.int64)
            times[seen] = unwrapped(self.card_us[seen], bits=32) * 1000
            self.table["time"] = times
            return "microseconds of the card (MVMExtra), 32 bits"
        self.table["time"] = self.device_ns
        return f"the device's timestamp, {'ns' if self.usrp else 'microseconds'}"


def _read_part(
    data: NDArray[np.uint8],
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
    layout: _Layout,
    rows: NDArray[np.int64],
    columns: _Columns,
    groups: list[tuple[Group, NDArray[np.int64]]],
    reasons: Counter[str],
) -> NDArray[np.int64]:
    """Decode frames of one layout into `groups`; returns those that do not fit."""
    segment = layout.segments[b"CSI"]
    size = header_bytes(segment.version)
    if size is None or segment.stop - segment.start < size:
        reasons[f"version {segment.version} of the CSI segment is not known"] += len(rows)
        return rows
    header = gather(data, starts[rows] + segment.start, size)
    broken = [np.zeros(0, np.int64)]
    for part in split(header):
        head = header[part[0]].tobytes()
        some = rows[part]
        raw = gather(data, starts[some] + segment.start + size, segment.stop - segment.start - size)
        # USRP: the subcarriers' numbers and the matrix's axes are in front of the values.
        told = raw[:, : min(raw.shape[1], 1 << 12)] if device_of(head) == USRP else raw[:, :0]
        numbers = 2 * int.from_bytes(_tones_of(head, segment.version), "little")
        for same in split(told[:, :numbers]) if device_of(head) == USRP else [np.arange(len(some))]:
            try:
                kind, csi = decoded(segment.version, head, raw[same])
            except ValueError as error:
                reasons[str(error)] += len(same)
                broken.append(some[same])
                continue
            groups.append((Group(kind, same, csi, {}), some[same]))
            _fill(data, starts, lengths, layout, some[same], device_of(head), columns)
    return np.concatenate(broken)


def _tones_of(header: bytes, version: int) -> bytes:
    at = {1: 25, 2: 25, 3: 25, 4: 26, 5: 35, 6: 35}[version]
    return header[at : at + 2]


def _fill(
    data: NDArray[np.uint8],
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
    layout: _Layout,
    rows: NDArray[np.int64],
    device: int,
    columns: _Columns,
) -> None:
    """Times, RSSI and senders of some frames of one layout."""
    columns.seen[rows] = True
    columns.usrp |= device == USRP
    basic = layout.segments.get(b"RxSBasic", _Segment(0, 0, 0))
    if basic.stop - basic.start == _BASIC_BYTES.get(basic.version):
        raw = gather(data, starts[rows] + basic.start, basic.stop - basic.start)
        words = np.ascontiguousarray(raw[:, 2:18]).view("<i8") & ((1 << 62) - 1)
        columns.device_ns[rows] = words[:, 0] if device == USRP else words[:, 0] % (1 << 53) * 1000
        if basic.version >= _WITH_SYSTEM_TIME:
            columns.system_ns[rows] = words[:, 1]
        at = _RSSI[basic.version]
        signed = np.ascontiguousarray(raw[:, at - 1 :]).view(np.int8).astype(np.int16)
        columns.table["noise"][rows] = signed[:, 0]
        columns.table["rssi"][rows, : signed.shape[1] - 1] = signed[:, 1:]
        dbm = signed[:, 1] if device in (AX200, AX210, USRP) else signed[:, 1] + signed[:, 0]
        known = (signed[:, 1] != 0) & (signed[:, 1] != -128)
        columns.table["rssi_dbm"][rows] = np.where(known, dbm, np.nan)
    card = layout.segments.get(b"MVMExtra", _Segment(0, 0, 0))
    if card.stop - card.start >= _CARD_CLOCK.stop:
        clock = gather(data, starts[rows] + card.start + _CARD_CLOCK.start, 4)
        columns.card_us[rows] = clock.view("<u4")[:, 0]
    packet = layout.packet + (4 if layout.packet_has_length else 0)
    told = rows[lengths[rows] >= packet + _SENDER.stop]
    columns.table["ue"][told] = address(gather(data, starts[told] + packet + _SENDER.start, 6))
    columns.has_senders |= bool(len(told))


def _alike(
    data: NDArray[np.uint8],
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
    first: int,
    layout: _Layout,
) -> NDArray[np.bool_]:
    """Which frames are arranged as `layout`, which is that of the one at `first`."""
    same = lengths >= layout.packet
    template = data[first + layout.fixed]
    for block in range(0, len(starts), 4096):
        rows = np.flatnonzero(same[block : block + 4096]) + block
        same[rows] = (data[starts[rows][:, None] + layout.fixed] == template).all(axis=1)
    return same


def _layout(raw: bytes) -> _Layout | None:
    """The arrangement of a frame with its length in front; None if its lengths do not fit together."""
    version, count = int.from_bytes(raw[8:10], "little"), raw[10] if len(raw) >= _HEADER else 0
    if raw[4:8] != _MAGIC.tobytes() or version not in (1, 2) or not 0 < count <= _MOST_SEGMENTS:
        return None
    # Since version 2 the number of packets follows, and each packet has its length in front.
    at = _HEADER + (2 if version == 2 else 0)
    fixed = [np.arange(4, _HEADER)]
    segments: dict[bytes, _Segment] = {}
    for _ in range(count):
        end = at + 4 + int.from_bytes(raw[at : at + 4], "little")
        named = at + 5 + int.from_bytes(raw[at + 4 : at + 5], "little")
        if not named + 2 <= end <= len(raw):
            return None
        name = raw[at + 5 : named].rstrip(b"\0")
        segments[name] = _Segment(int.from_bytes(raw[named : named + 2], "little"), named + 2, end)
        fixed.append(np.arange(at, named + 2))
        at = end
    return _Layout(segments, at, version == 2, np.concatenate(fixed))
