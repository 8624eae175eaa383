"""Logs of the Atheros CSI Tool (`.dat`), with or without a byte that tells the order, and of its BPI-R2 fork.

A record is a length (2 bytes) and data: a header of 25 bytes, CSI, the packet. A first byte of 0xff says that
numbers are big endian, 0x00 that they are little endian; without it either can be. The BPI-R2 fork writes the
length big endian and the rest little endian. CSI is for each subcarrier, for each stream, for each antenna,
imaginary and real part of 10 bits.
"""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.wifi import tones
from chachart.sources.formats.wifi.bits import imaginary_first_of_10
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.log import Group, Kind, Log, address, gather, merged, split
from chachart.sources.formats.wifi.walk import Head, walk

NAME = "Atheros .dat"

_PREFIX, _HEADER = 2, 25
_TONES = {56: 20, 114: 40}
"""Subcarriers of 20 and 40 MHz."""
_SENDER = slice(10, 16)
_TRIED = 3
"""So many records decide which way the file is written."""
_BLOCK = 256
_FILLED = 8
"""CSI is never longer than its values by so many bytes."""


class _Way(NamedTuple):
    """How a file is written: byte orders of lengths and of the rest, and where the first record begins."""

    length: str
    rest: str
    first: int


_WAYS = tuple(
    _Way(length, rest, first)
    for first in (1, 0)
    for length, rest in (("little", "little"), ("big", "big"), ("big", "little"))
)
_FLAGS = {0x00: "little", 0xFF: "big"}


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    found = _way(np.frombuffer(head, np.uint8))
    return None if found else "its first record has not the length that its antennas need"


def open_capture(path: Path) -> WifiCapture:
    """The CSI of a log.

    Raises
    ------
    SetupError
        If the log cannot be read or has no CSI.
    """
    return WifiCapture(path, NAME, read)


def read(data: NDArray[np.uint8]) -> Log:
    """The frames of whole records, bytes (N,) as a file has them.

    Raises
    ------
    ValueError
        If it does not begin with a record.
    """
    way = _way(data)
    if way is None:
        raise ValueError("its first record has not the length that its antennas need")
    head = Head(_PREFIX, 0, _PREFIX, way.length == "big", least=_HEADER)
    found = walk(data, head, partial(_plausible, data, way), at=way.first)
    left_out: Counter[str] = Counter()
    if found.broken:
        left_out["broken record"] = found.broken
    if found.cut:
        left_out["cut short"] = 1
    header = gather(data, found.starts, _HEADER)
    fields = _fields(header, way)
    silent = (fields["csi_bytes"] == 0) & (fields["payload"] == found.lengths - _HEADER)
    good = _fits(fields, found.lengths)
    if bad := int(np.count_nonzero(~good & ~silent)):
        left_out["broken record"] += bad
    remarks = [f"{int(silent.sum())} packets without CSI"] if silent.any() else []
    counted = np.cumsum(~silent) - 1
    rows = np.flatnonzero(good)
    starts = found.starts[rows]
    fields = {name: values[rows] for name, values in (fields | {"length": found.lengths}).items()}
    columns, told = _columns(data, starts, fields)
    keys = [fields[n] for n in ("tones", "antennas", "streams")]
    channel = fields["channel"]
    keys += [channel & 255, channel >> 8]
    groups = [
        _group(
            data, starts[part], {n: v[part] for n, v in fields.items()}, counted[rows][part], columns, part
        )
        for part in split(np.column_stack(keys))
    ]
    clock = "64-bit count of microseconds"
    return Log(merged(groups), left_out, clock, told, ("shape", "bandwidth_hz", "carrier_hz"), remarks)


def _group(
    data: NDArray[np.uint8],
    starts: NDArray[np.int64],
    fields: dict[str, NDArray[np.int64]],
    number: NDArray[np.int64],
    columns: dict[str, NDArray[Any]],
    rows: NDArray[np.int64],
) -> Group:
    count, antennas, sent = (int(fields[name][0]) for name in ("tones", "antennas", "streams"))
    mhz = _TONES[count]
    hz = float(fields["channel"][0]) * 1e6 or None
    kind = Kind(
        antennas, sent, count, tones.standard("ht", mhz, count, False), (), hz, bandwidth_hz=mhz * 1e6
    )
    csi = np.empty((len(rows), antennas, sent, count), np.complex64)
    numbers = 2 * count * antennas * sent
    for first in range(0, len(rows), _BLOCK):
        block = slice(first, first + _BLOCK)
        raw = gather(data, starts[block] + _HEADER, numbers * 10 // 8)
        values = imaginary_first_of_10(raw, numbers // 2)
        csi[block] = values.reshape(-1, count, sent, antennas).transpose(0, 3, 2, 1)
    own = {name: values[rows] for name, values in columns.items()}
    own["rssi"] = own["rssi"][:, :antennas]
    return Group(kind, number, csi, own)


def _columns(
    data: NDArray[np.uint8], starts: NDArray[np.int64], fields: dict[str, NDArray[np.int64]]
) -> tuple[dict[str, NDArray[Any]], bool]:
    """What the headers say besides the shape, and whether packets say who sent them."""
    there = np.minimum(fields["payload"], fields["length"] - _HEADER - fields["csi_bytes"])
    told = there >= _SENDER.stop
    senders = np.zeros(len(starts), np.uint64)
    packet = starts[told] + _HEADER + fields["csi_bytes"][told]
    senders[told] = address(gather(data, packet + _SENDER.start, 6))
    rssi = np.column_stack([fields[f"rssi_{n}"] for n in range(3)]).astype(np.int16)
    whole = fields["rssi"]
    columns: dict[str, NDArray[Any]] = {
        "time": fields["clock"] * 1000,
        "ue": senders,
        "rssi": rssi,
        "noise": fields["noise"].astype(np.int16),
        # The chip gives RSSI above its noise floor, nominally -95 dBm; 128 means none.
        "rssi_dbm": np.where(whole < 128, whole - 95.0, np.nan).astype(np.float32),
    }
    return columns, bool(told.any())


def _fields(header: NDArray[np.uint8], way: _Way) -> dict[str, NDArray[np.int64]]:
    """The header's numbers, from records' first 25 bytes (F, 25)."""
    order = ">" if way.rest == "big" else "<"

    def word(at: int, size: int) -> NDArray[np.int64]:
        return np.ascontiguousarray(header[:, at : at + size]).view(f"{order}u{size}")[:, 0].astype(np.int64)

    names = ("tones", "antennas", "streams", "rssi", "rssi_0", "rssi_1", "rssi_2")
    fields = {name: header[:, 16 + n].astype(np.int64) for n, name in enumerate(names)}
    signed = np.ascontiguousarray(header[:, 13]).view(np.int8).astype(np.int64)
    return fields | {
        "clock": word(0, 8),
        "csi_bytes": word(8, 2),
        "channel": word(10, 2),
        "noise": signed,
        "payload": word(23, 2),
    }


def _fits(fields: dict[str, NDArray[np.int64]], length: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether records of such headers and lengths have room for the CSI that they say they have."""
    count, antennas, sent = fields["tones"], fields["antennas"], fields["streams"]
    sensible = np.isin(count, list(_TONES))
    sensible &= (antennas >= 1) & (antennas <= 3) & (sent >= 1) & (sent <= 3)
    needed = -(-count * antennas * sent * 20 // 8)
    fits: NDArray[np.bool_] = sensible & (fields["csi_bytes"] >= needed)
    # Some forks cut the packet short; where nothing is cut, bytes may follow that fill up a word.
    fits &= length >= _HEADER + fields["csi_bytes"]
    fits &= fields["csi_bytes"] < needed + _FILLED
    return fits


def _plausible(data: NDArray[np.uint8], way: _Way, at: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether a whole record begins at these places."""
    found = at + _PREFIX + _HEADER <= len(data)
    some = at[found]
    header = gather(data, some + _PREFIX, _HEADER)
    high, low = (0, 1) if way.length == "big" else (1, 0)
    length = data[some + high].astype(np.int64) * 256 + data[some + low]
    found[found] = _fits(_fields(header, way), length) & (some + _PREFIX + length <= len(data))
    return found


def _way(data: NDArray[np.uint8]) -> _Way | None:
    """The way in which the most of the first records make sense; None if in no way any does."""
    best: tuple[int, _Way | None] = (0, None)
    for way in _WAYS:
        if way.first and (not len(data) or _FLAGS.get(int(data[0])) != way.length):
            continue
        count = _records(data, way)
        if count > best[0]:
            best = count, way
    return best[1]


def _records(data: NDArray[np.uint8], way: _Way) -> int:
    """How many of the first records fit; one that reaches beyond the data counts by its header."""
    at = way.first
    for count in range(_TRIED):
        if at + _PREFIX + _HEADER > len(data):
            return count
        length = int.from_bytes(data[at : at + _PREFIX].tobytes(), "big" if way.length == "big" else "little")
        header = data[at + _PREFIX : at + _PREFIX + _HEADER][None]
        fields = _fields(header, way)
        silent = length == _HEADER + int(fields["payload"][0]) and not fields["csi_bytes"][0]
        if not _fits(fields, np.array([length]))[0] and not silent:
            return count
        at += _PREFIX + length
    return _TRIED
