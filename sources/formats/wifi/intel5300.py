"""Intel 5300: logs of the Linux 802.11n CSI Tool (`.dat`), and records of its WSR fork.

A record is a big-endian length (2 bytes), a code, and data. Code 0xBB is CSI: a header of 20 bytes, then 30
groups of subcarriers, each 3 unused bits and, for each antenna, for each stream, real and imaginary part of
8 bits. The WSR fork has 18 bytes more between header and CSI: seconds and microseconds of the computer's
clock, the sender, the number of the frame. Code 0xC1 is the payload of the packet whose CSI comes next.

Antennas are in the order of the connectors; chain n received on connector (antenna_sel >> 2n) & 3.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.clock import unwrapped
from chachart.sources.formats.wifi import tones
from chachart.sources.formats.wifi.bits import pairs_of_8
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.log import Group, Kind, Log, address, gather, split
from chachart.sources.formats.wifi.walk import Head, walk

NAME = "Intel 5300 .dat"

_CSI, _PAYLOAD = 0xBB, 0xC1
_PREFIX = 2
_HEADER, _FORK = 20, 18
"""Bytes of the header, code left out, and what the WSR fork puts behind it."""
_GROUPS, _GAP = 30, 3
_HT40 = 0x800
"""The bit of rate_n_flags that says 40 MHz."""
_SENDER = slice(10, 16)
"""Where an 802.11 header has the transmitter's address."""
_ANTENNAS = "ABCD"
_BLOCK = 4096


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    if len(head) < 3 + _HEADER or head[2] not in (_CSI, _PAYLOAD):
        return "its first record has no code 0xBB or 0xC1"
    if (
        head[2] == _CSI
        and not _plausible(np.frombuffer(head, np.uint8), np.zeros(1, np.int64), whole=False)[0]
    ):
        return "its first record has not the length that its antennas need"
    return None


def open_capture(path: Path) -> WifiCapture:
    """The CSI of a log.

    Raises
    ------
    SetupError
        If the log cannot be read or has no CSI.
    """
    return WifiCapture(path, NAME, read)


def read(data: NDArray[np.uint8]) -> Log:
    """The frames of whole records, bytes (N,) as a file or the tool's TCP connection has them."""
    found = walk(
        data, Head(_PREFIX, 0, _PREFIX, big_endian=True), lambda at: _plausible(data, at, whole=True)
    )
    code = data[found.starts] if len(found.starts) else np.zeros(0, np.uint8)
    left_out: Counter[str] = Counter()
    if found.broken:
        left_out["broken record"] = found.broken
    if found.cut:
        left_out["cut short"] = 1
    csi = np.flatnonzero((code == _CSI) & (found.lengths > _HEADER))
    header = gather(data, found.starts[csi] + 1, _HEADER)
    extra = _fits(header, found.lengths[csi] - 1)
    good = extra >= 0
    if not good.all():
        left_out["broken record"] += int(np.count_nonzero(~good))
    senders = _payload_senders(data, found.starts, found.lengths, code)
    number = np.arange(len(csi))[good]
    starts, header, extra = found.starts[csi][good] + 1, header[good], extra[good]
    columns = _columns(data, starts, header, extra)
    if senders is not None:
        columns["ue"] = np.where(extra == _FORK, columns["ue"], senders[csi][good])
    keys = np.column_stack([header[:, 8:10], header[:, 15], header[:, 19] & (_HT40 >> 8), extra])
    parts: dict[Kind, list[tuple[list[int], NDArray[np.int64]]]] = {}
    for rows in split(keys):
        kind, order = _kind(header[rows[0]])
        parts.setdefault(kind, []).append((order, rows))
    groups = [
        _group(data, starts + _HEADER + extra, kind, chains, number, columns)
        for kind, chains in parts.items()
    ]
    told = senders is not None or bool((extra == _FORK).any())
    return Log(groups, left_out, "1 MHz counter of 32 bits", told)


def _kind(header: NDArray[np.uint8]) -> tuple[Kind, list[int]]:
    """What a header (20,) says of its frame, and the chains in the order of their connectors."""
    antennas, sent, chosen = (int(header[n]) for n in (8, 9, 15))
    connector = [chosen >> 2 * chain & 3 for chain in range(antennas)]
    order = np.argsort(connector, kind="stable").tolist()
    mhz = 40 if header[19] & (_HT40 >> 8) else 20
    names = tuple(_ANTENNAS[connector[chain]] for chain in order)
    return Kind(antennas, sent, _GROUPS, tones.intel5300(mhz), names, bandwidth_hz=mhz * 1e6), order


def _group(
    data: NDArray[np.uint8],
    starts: NDArray[np.int64],
    kind: Kind,
    parts: list[tuple[list[int], NDArray[np.int64]]],
    number: NDArray[np.int64],
    columns: dict[str, NDArray[Any]],
) -> Group:
    """The frames of one kind; `parts` has the order of the chains, and the rows that share it."""
    rows = np.sort(np.concatenate([part for _, part in parts]))
    csi = np.empty((len(rows), *kind.shape), np.complex64)
    flat = csi.view(np.float32).reshape(*csi.shape, 2)
    pairs_each = kind.antennas * kind.streams
    for order, part in parts:
        places = np.searchsorted(rows, part)
        for first in range(0, len(part), _BLOCK):
            block: slice | NDArray[np.int64] = places[first : first + _BLOCK]
            if len(parts) == 1:
                block = slice(first, first + _BLOCK)
            raw = gather(data, starts[part[first : first + _BLOCK]], _csi_bytes(pairs_each))
            pairs = pairs_of_8(raw, _GROUPS, _GAP, pairs_each)
            for place, chain in enumerate(order):
                for stream in range(kind.streams):
                    for half in (0, 1):
                        flat[block, place, stream, :, half] = pairs[:, :, chain * kind.streams + stream, half]
    return Group(kind, number[rows], csi, {name: values[rows] for name, values in columns.items()})


def _columns(
    data: NDArray[np.uint8], starts: NDArray[np.int64], header: NDArray[np.uint8], extra: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """What the headers (F, 20) say besides the shape."""
    rssi = header[:, 10:13].astype(np.int16)
    noise = np.ascontiguousarray(header[:, 13]).view(np.int8).astype(np.int16)
    agc = header[:, 14].astype(np.int16)
    power = np.where(rssi > 0, 10 ** (rssi / 10), 0.0).sum(axis=1)
    with np.errstate(divide="ignore"):
        total = 10 * np.log10(power) - 44 - agc
    clock = np.ascontiguousarray(header[:, :4]).view("<u4")[:, 0]
    columns: dict[str, NDArray[Any]] = {
        "time": unwrapped(clock, bits=32) * 1000,
        "ue": np.zeros(len(header), np.uint64),
        "rssi": rssi,
        "agc": agc,
        "noise": noise,
        "rssi_dbm": np.where(power > 0, total, np.nan).astype(np.float32),
    }
    fork = extra == _FORK
    if fork.any():
        more = np.zeros((len(header), _FORK), np.uint8)
        more[fork] = gather(data, starts[fork] + _HEADER, _FORK)
        words = np.ascontiguousarray(more[:, :8]).view("<u4").astype(np.int64)
        columns["ue"] = address(more[:, 8:14])
        columns["host_time"] = words[:, 0] * 1_000_000_000 + words[:, 1] * 1000
        columns["frame_count"] = np.ascontiguousarray(more[:, 14:18]).view("<u4")[:, 0].astype(np.int64)
    return columns


def _payload_senders(
    data: NDArray[np.uint8], starts: NDArray[np.int64], lengths: NDArray[np.int64], code: NDArray[np.uint8]
) -> NDArray[np.uint64] | None:
    """For each record the sender in the payload record before it, 0 without; None where no payload is."""
    payload = np.flatnonzero((code == _PAYLOAD) & (lengths > _SENDER.stop))
    if not len(payload):
        return None
    senders = np.zeros(len(code) + 1, np.uint64)
    senders[payload + 1] = address(gather(data, starts[payload] + 1 + _SENDER.start, 6))
    return senders[:-1]


def _fits(header: NDArray[np.uint8], length: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bytes between header and CSI of records of such headers (F, 20) and lengths; -1 where nothing fits."""
    antennas, sent = header[:, 8].astype(np.int64), header[:, 9].astype(np.int64)
    expected = _csi_bytes(antennas * sent)
    said = header[:, 16].astype(np.int64) + 256 * header[:, 17].astype(np.int64)
    extra = length - _HEADER - expected
    sensible = (antennas >= 1) & (antennas <= 3) & (sent >= 1) & (sent <= 4) & (said == expected)
    fits: NDArray[np.int64] = np.where(sensible & ((extra == 0) | (extra == _FORK)), extra, -1)
    return fits


def _plausible(data: NDArray[np.uint8], at: NDArray[np.int64], whole: bool) -> NDArray[np.bool_]:
    """Whether a record of CSI begins at these places, and, if asked for, is there as a whole."""
    room = at + _PREFIX + 1 + _HEADER <= len(data)
    found = np.zeros(len(at), bool)
    found[room] = data[at[room] + _PREFIX] == _CSI
    some = at[found]
    length = data[some].astype(np.int64) * 256 + data[some + 1]
    good = _fits(gather(data, some + _PREFIX + 1, _HEADER), length - 1) >= 0
    found[found] = good & (some + _PREFIX + length <= len(data)) if whole else good
    return found


def _csi_bytes(pairs: Any) -> Any:
    return (_GROUPS * (16 * pairs + _GAP) + 7) // 8
