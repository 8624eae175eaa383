"""Captures of FeitCSI (`.csi`) from Intel AX200, AX210 and their like, and its UDP datagrams.

A record is a header of 272 bytes, whose first word says how many bytes of CSI follow, and the CSI: for each
receive antenna, for each stream, for each subcarrier, real and imaginary part of 16 bits. (PicoScenes reads
the same card's values imaginary part first: one of the two has the conjugate, which mirrors angle and delay.)
"""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.clock import unwrapped
from chachart.sources.formats.wifi import tones
from chachart.sources.formats.wifi.bits import complex_of_16
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.log import Group, Kind, Log, Tones, address, gather, merged, split
from chachart.sources.formats.wifi.walk import Head, walk

NAME = "FeitCSI .csi"

_HEADER = 272
_BLOCK_BYTES = 1 << 19
_FORMATS = {1: "legacy", 2: "ht", 3: "vht", 4: "he", 5: "eht"}
_MOST_TONES = 4096
_UNUSED_AT_160_MHZ = {"vht": (498, slice(242, 256)), "he": (2020, slice(996, 1024))}
"""Subcarriers that the firmware puts in the middle of 160 MHz by mistake, where they were not taken out."""


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    if len(head) < _HEADER:
        return f"it is shorter than a header of {_HEADER} bytes"
    data = np.frombuffer(head, np.uint8)
    fits = _fits(data[None, :_HEADER], data[:4].view("<u4").astype(np.int64))
    return None if fits[0] else "its first record has not the length that its antennas need"


def open_capture(path: Path) -> WifiCapture:
    """The CSI of a capture.

    Raises
    ------
    SetupError
        If the capture cannot be read or has no CSI.
    """
    return WifiCapture(path, NAME, read)


def read(data: NDArray[np.uint8]) -> Log:
    """The frames of whole records, bytes (N,) of a file or of a datagram."""
    head = Head(_HEADER, 0, 4, big_endian=False, least=4, most=1 << 20)
    found = walk(data, head, partial(_plausible, data))
    header = gather(data, found.starts - _HEADER, _HEADER)
    good = _fits(header, found.lengths)
    left_out: Counter[str] = Counter()
    if bad := found.broken + int(np.count_nonzero(~good)):
        left_out["broken record"] = bad
    if found.cut:
        left_out["cut short"] = 1
    number = np.flatnonzero(good)
    header, starts, lengths = header[good], found.starts[good], found.lengths[good]
    clock = _words(header, 88)
    time = unwrapped(clock, bits=32) * 1000
    rates = _words(header, 92)
    count = _words(header, 52)
    keys = np.column_stack([header[:, 46:48], count & 255, count >> 8, rates >> 8 & 63, lengths >> 12 & 255])
    groups = []
    for rows in split(keys):
        head_of = header[rows]
        kind, keep = _kind(head_of[0])
        own: dict[str, NDArray[Any]] = {
            "time": time[rows],
            "ue": address(head_of[:, 68:74]),
            "rssi": -np.minimum(np.column_stack([_words(head_of, at) for at in (60, 64)]), 255),
            "ftm_clock": _words(head_of, 8),
        }
        own["rssi"] = own["rssi"].astype(np.int16)[:, : kind.antennas]
        milliwatts = np.where(own["rssi"] < 0, 10 ** (own["rssi"] / 10), 0).sum(axis=1)
        with np.errstate(divide="ignore"):
            dbm = 10 * np.log10(milliwatts)
        own["rssi_dbm"] = np.where(milliwatts > 0, dbm, np.nan).astype(np.float32)
        csi = np.empty((len(rows), *kind.shape), np.complex64)
        block = max(1, _BLOCK_BYTES // int(lengths[rows[0]]))
        for first in range(0, len(rows), block):
            part = slice(first, first + block)
            values = complex_of_16(gather(data, starts[rows[part]], int(lengths[rows[0]])))
            values = values.reshape(
                -1, kind.antennas, kind.streams, values.shape[1] // (kind.antennas * kind.streams)
            )
            csi[part] = values if len(keep) == values.shape[3] else values[..., keep]
        groups.append(Group(kind, number[rows], csi, own))
    order = ("shape", "bandwidth_hz", "packet_format")
    return Log(merged(groups), left_out, "u32 of microseconds of the card", True, order)


def _kind(header: NDArray[np.uint8]) -> tuple[Kind, NDArray[np.intp]]:
    """What such a header (272,) says, and which of its subcarriers are CSI."""
    rate, count = int(header[92:96].view("<u4")[0]), int(header[52:56].view("<u4")[0])
    packet_format = _FORMATS.get(rate >> 8 & 7, "")
    mhz = 20 << (rate >> 11 & 7)
    keep = np.arange(count)
    with_unused, unused = _UNUSED_AT_160_MHZ.get(packet_format, (0, slice(0)))
    if mhz == 160 and count == with_unused:
        keep = np.delete(keep, unused)
    numbers = _tones(packet_format, mhz, len(keep))
    kind = Kind(
        int(header[46]),
        int(header[47]),
        len(keep),
        numbers,
        bandwidth_hz=mhz * 1e6,
        packet_format=packet_format,
    )
    return kind, keep


def _tones(packet_format: str, mhz: int, count: int) -> Tones:
    if packet_format == "eht":
        return tones.standard("he", mhz, count, weak_pilots=True)
    return tones.standard(packet_format, mhz, count, weak_pilots=True)


def _words(header: NDArray[np.uint8], at: int) -> NDArray[np.int64]:
    return np.ascontiguousarray(header[:, at : at + 4]).view("<u4")[:, 0].astype(np.int64)


def _fits(header: NDArray[np.uint8], length: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether records of such headers (F, 272) have just the CSI that they say they have."""
    received, sent = header[:, 46].astype(np.int64), header[:, 47].astype(np.int64)
    count = _words(header, 52)
    sensible = (received >= 1) & (received <= 4) & (sent >= 1) & (sent <= 4)
    sensible &= (count >= 1) & (count <= _MOST_TONES)
    fits: NDArray[np.bool_] = sensible & (length == 4 * received * sent * count)
    return fits


def _plausible(data: NDArray[np.uint8], at: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether a whole record begins at these places."""
    found = at + _HEADER <= len(data)
    near = at[found]
    octets = np.column_stack([data[near + n] for n in (46, 47)])
    likely = ((octets >= 1) & (octets <= 4)).all(axis=1) & (data[near + 3] == 0) & (data[near + 55] == 0)
    found[found] = likely
    some = at[found]
    header = gather(data, some, _HEADER)
    length = _words(header, 0)
    found[found] = _fits(header, length) & (some + _HEADER + length <= len(data))
    return found
