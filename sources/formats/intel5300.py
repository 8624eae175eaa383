"""Intel 5300 logs of the Linux 802.11n CSI Tool (`.dat`).

Records of a big-endian length (2 bytes), a code, and data. Code 0xBB is CSI of 30 groups of subcarriers,
whose indices are those of 802.11n and not quite even. Variables: `csi` for the first transmit stream,
`csi_1` ... for the others, `time` in nanoseconds from the card's 1 MHz clock. Antennas are in the order of
the connectors.
"""

from __future__ import annotations

import mmap
from pathlib import Path

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture
from chachart.sources.formats.wifi import WifiCapture, alike, csiread, streams, unwrapped_ns

NAME = "Intel 5300 .dat"

_CSI, _PAYLOAD = 0xBB, 0xC1
_HEADER = 20
"""Bytes before the CSI in a record of code 0xBB, after length and code."""


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    if len(head) < 3 + _HEADER or head[2] not in (_CSI, _PAYLOAD):
        return "its first record has no code 0xBB or 0xC1"
    if head[2] == _CSI and not _fits(head[3:], int.from_bytes(head[:2], "big") - 1):
        return "its first record has not the length that its antennas need"
    return None


def open_capture(path: Path) -> Capture:
    """The CSI of a log.

    Raises
    ------
    SetupError
        If the log is damaged or cut short, or its frames differ in their antennas.
    """
    reader = csiread()
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            antennas, sent = alike(_antennas(data), "(antennas, streams)")
        log = reader.Intel(str(path), nrxnum=antennas, ntxnum=sent, if_report=False)
        log.read()
    except (ValueError, OSError) as error:
        raise SetupError(f"{path} is damaged or cut short: {error}") from None
    time = unwrapped_ns(log.timestamp_low, bits=32, tick_ns=1000)
    return WifiCapture(path, NAME, streams(log.csi) | {"time": time})


def _antennas(data: mmap.mmap) -> list[tuple[int, ...]]:
    """(receive antennas, transmit streams) of each CSI record, after a check of each record's length."""
    found: list[tuple[int, ...]] = []
    at = 0
    while at < len(data):
        length = int.from_bytes(data[at : at + 2], "big")
        if length < 1 or at + 2 + length > len(data):
            raise ValueError(f"it ends within the record after CSI frame {len(found)}")
        body = data[at + 3 : at + 3 + min(length - 1, _HEADER)]
        if data[at + 2] == _CSI:
            if not _fits(body, length - 1):
                raise ValueError(f"CSI frame {len(found)} has not the length that its antennas need")
            found.append((body[8], body[9]))
        at += 2 + length
    return found


def _fits(body: bytes, length: int) -> bool:
    """Whether a CSI record's body of so many bytes has room for just what it says it has."""
    if len(body) < _HEADER:
        return False
    pairs = body[8] * body[9]
    expected = (30 * (pairs * 16 + 3) + 7) // 8
    said = int.from_bytes(body[16:18], "little")
    return 1 <= body[8] <= 3 and 1 <= body[9] <= 3 and said == expected == length - _HEADER
