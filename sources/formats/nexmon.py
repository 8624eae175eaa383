"""Captures of nexmon_csi on Broadcom chips (`.pcap`).

One packet has the CSI of one core, that is one antenna; the packets of all cores of a received frame make
one frame here, and those of which a core is missing are left out. The file does not say how its chip writes
numbers: `csi` is for those with 16-bit integers (bcm4339, bcm43455c0), `csi_4358` and `csi_4366c0` for the
two with floats of their own. Also `ue`, the sender's address as a number, and `time` in nanoseconds. Only
the first spatial stream is read.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture
from chachart.sources.formats.wifi import WifiCapture, alike, csiread

NAME = "Nexmon .pcap"

_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""The beginnings of pcap files: byte order, and nanoseconds in the second word of a time."""
_FILE_HEADER, _PACKET_HEADER = 24, 16
_BEFORE_CSI = 42 + 18
_BANDWIDTHS = {64: 20, 128: 40, 256: 80}
_CHIPS = {"csi": "43455c0", "csi_4358": "4358", "csi_4366c0": "4366c0"}


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    return None if head[:4] in _MAGICS else "it is no pcap file"


def open_capture(path: Path) -> Capture:
    """The CSI of a capture.

    Raises
    ------
    SetupError
        If the capture is damaged or cut short, has no CSI, or CSI of several bandwidths.
    """
    reader = csiread()
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            lengths = list(_csi_bytes(data))
            _, tick_ns = _MAGICS[data[:4]]
        [length] = alike(lengths, "a length of CSI")
        if length // 4 not in _BANDWIDTHS or length % 4:
            raise ValueError(f"{length} bytes of CSI are no 20, 40 or 80 MHz")
        decoded = {}
        for name, chip in _CHIPS.items():
            # One more than there are: it also notes the time of a packet that is not Nexmon's.
            log = reader.Nexmon(str(path), chip, _BANDWIDTHS[length // 4], False, len(lengths) + 1)
            log.read()
            decoded[name] = log.csi
        rows = _whole_frames(log)
    except (ValueError, OSError) as error:
        raise SetupError(f"{path} is damaged or cut short: {error}") from None
    times = log.sec.astype(np.int64) * 1_000_000_000 + log.usec.astype(np.int64) * tick_ns
    address = (log.src_addr.astype(np.int64) << np.arange(40, -8, -8)).sum(axis=1)
    columns = {"ue": address[rows[:, 0]], "time": times[rows[:, 0]]}
    arrays = {name: csi[rows] for name, csi in decoded.items()} | columns
    return WifiCapture(path, NAME, arrays, axes=("ue", "antenna", "subcarrier"))


def _csi_bytes(data: mmap.mmap) -> Iterator[tuple[int]]:
    """Bytes of CSI in each Nexmon packet, after a check of each packet's length."""
    order, _ = _MAGICS[data[:4]]
    header = struct.Struct(f"{order}4I")
    at, packet = _FILE_HEADER, 0
    while at < len(data):
        start = at + _PACKET_HEADER
        length = header.unpack_from(data, at)[2] if start <= len(data) else 0
        at = start + length
        if at > len(data):
            raise ValueError(f"it ends within packet {packet}")
        if data[start + 6 : start + 12] == b"NEXMON":
            if not _BEFORE_CSI < length <= _BEFORE_CSI + 4 * max(_BANDWIDTHS):
                raise ValueError(f"packet {packet} has {length} bytes")
            yield (length - _BEFORE_CSI,)
        packet += 1


def _whole_frames(log: Any) -> NDArray[np.intp]:
    """Packets (frames, cores) that belong together: same sender and sequence number, one after another."""
    first = np.flatnonzero(log.spatial == log.spatial.min())
    key = np.column_stack([log.src_addr, log.seq])[first]
    group = np.cumsum(np.append(False, (key[1:] != key[:-1]).any(axis=1)))
    cores = np.unique(log.core[first])
    order = np.lexsort((log.core[first], group))
    counts = np.bincount(group)
    starts = np.cumsum(counts) - counts
    rows = first[order][starts[counts == len(cores)][:, None] + np.arange(len(cores))]
    whole: NDArray[np.intp] = rows[(log.core[rows] == cores).all(axis=1)]
    if not len(whole):
        raise ValueError(f"no frame has all of its {len(cores)} cores")
    return whole
