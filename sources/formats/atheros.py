"""Logs of the Atheros CSI Tool (`.dat`).

Records of a length (2 bytes, in the byte order of the machine that wrote them) and data: a header of 25
bytes, packed CSI of 10-bit numbers, a payload. Variables: `csi` for the first transmit stream, `csi_1` ...
for the others, `time` in nanoseconds.
"""

from __future__ import annotations

import mmap
from pathlib import Path

import numpy as np

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture
from chachart.sources.formats.wifi import WifiCapture, alike, csiread, streams

NAME = "Atheros .dat"

_HEADER = 25
_TONES = (56, 114)
_LONGEST = 4096
Order = str


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    return None if _order(head) else "its first record has not the length that its antennas need"


def open_capture(path: Path) -> Capture:
    """The CSI of a log.

    Raises
    ------
    SetupError
        If the log is damaged or cut short, or its frames differ in their antennas or subcarriers.
    """
    reader = csiread()
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            order = _order(data[: 2 + _HEADER])
            shapes = _shapes(data, order)
        tones, antennas, sent = alike(shapes, "(subcarriers, antennas, streams)")
        log = reader.Atheros(
            str(path), nrxnum=antennas, ntxnum=sent, tones=tones, if_report=False, bufsize=len(shapes)
        )
        log.read(endian=order)
    except (ValueError, OSError) as error:
        raise SetupError(f"{path} is damaged or cut short: {error}") from None
    return WifiCapture(path, NAME, streams(log.csi) | {"time": log.timestamp.astype(np.int64) * 1000})


def _order(head: bytes) -> Order:
    """The byte order in which the first record makes sense, or an empty string."""
    return next((order for order in ("little", "big") if _shape(head, order) is not None), "")


def _shape(record: bytes, order: Order) -> tuple[int, ...] | None:
    """(subcarriers, antennas, streams) of a record, None where its lengths do not fit together."""

    def word(at: int) -> int:
        return int.from_bytes(record[at : at + 2], "little" if order == "little" else "big")

    if len(record) < 2 + _HEADER:
        return None
    length, csi, payload = word(0), word(10), word(25)
    tones, antennas, sent = record[18], record[19], record[20]
    bits = tones * antennas * sent * 20
    room = -(-bits // 16) * 2 <= csi <= _LONGEST and payload <= _LONGEST
    sensible = tones in _TONES and 1 <= antennas <= 3 and 1 <= sent <= 3
    return (tones, antennas, sent) if sensible and room and length == _HEADER + csi + payload else None


def _shapes(data: mmap.mmap, order: Order) -> list[tuple[int, ...]]:
    found: list[tuple[int, ...]] = []
    at = 0
    while at < len(data):
        shape = _shape(data[at : at + 2 + _HEADER], order)
        if shape is None:
            raise ValueError(f"the lengths in frame {len(found)} do not fit together")
        at += 2 + int.from_bytes(data[at : at + 2], "little" if order == "little" else "big")
        if at > len(data):
            raise ValueError(f"it ends within frame {len(found)}")
        found.append(shape)
    return found
