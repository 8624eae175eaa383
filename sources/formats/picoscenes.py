"""Captures of PicoScenes (`.csi`) from Intel 5300, AX200 and AX210, Atheros QCA9300 and USRP.

Frames of named segments with a version each. Read are `RxSBasic` (versions 1 to 5), `CSI` (1 to 6) and the
sender's address in the packet itself, as PicoScenes' own RXS-Parsing-Core does. csiread is left out here: it
trusts every length in many more segments than these two, ends the process where a length is damaged, reads
no CSI segment after version 4, and has I and Q of the AX200 and AX210 the other way around.

Variables: `csi` for the first transmit stream, `csi_1` ... for the others; `timestamp`, the device's own
count; `time` in nanoseconds and `ue`, the sender's address as a number, where every frame has them.
Subcarriers are those of the file in its order: pilots, which are weak in AX200 and AX210, are kept.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture
from chachart.sources.formats.picoscenes_csi import decoded
from chachart.sources.formats.wifi import WifiCapture, streams

NAME = "PicoScenes .csi"

_MAGIC = b"\x15\x03\x15\x20"
_HEADER = struct.Struct("<I4sHB")
_BASIC_BYTES = {1: 26, 2: 28, 3: 32, 4: 40, 5: 47}
_WITH_SYSTEM_TIME = 4
"""The first version of RxSBasic that has the computer's time besides the device's."""
_SENDER = slice(10, 16)


class _Frame(NamedTuple):
    csi: NDArray[Any]
    timestamp: int
    system_ns: int | None
    sender: int | None


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    return None if head[4:8] == _MAGIC else "its first frame has not PicoScenes' number"


def open_capture(path: Path) -> Capture:
    """The CSI of a capture; frames without a CSI segment are left out.

    Raises
    ------
    SetupError
        If the capture is damaged or cut short, is of a device or version that is not known, or its frames
        differ in their antennas or subcarriers.
    """
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            found = _frames(data)
    except (ValueError, OSError) as error:
        raise SetupError(f"{path} is damaged or cannot be imported: {error}") from None
    with np.errstate(invalid="ignore"):
        arrays = streams(np.stack([frame.csi for frame in found]))
    columns: dict[str, list[int | None]] = {
        "timestamp": [frame.timestamp for frame in found],
        "time": [frame.system_ns for frame in found],
        "ue": [frame.sender for frame in found],
    }
    whole = {n: np.array(values, np.uint64) for n, values in columns.items() if None not in values}
    return WifiCapture(path, NAME, arrays | {name: values.astype(np.int64) for name, values in whole.items()})


def _frames(data: mmap.mmap) -> list[_Frame]:
    """The frames that have CSI, all of one shape."""
    found: list[_Frame] = []
    at = number = 0
    while at < len(data):
        end = at + 4 + int.from_bytes(data[at : at + 4], "little")
        if end > len(data):
            raise ValueError(f"it ends within frame {number}, or the length of that frame is wrong")
        try:
            frame = _frame(data[at:end])
        except ValueError as error:
            raise ValueError(f"frame {number}: {error}") from None
        if frame is not None:
            found.append(frame)
            if frame.csi.shape != found[0].csi.shape:
                shapes = f"{frame.csi.shape}, the first has {found[0].csi.shape}"
                raise ValueError(f"frame {number} has (subcarriers, antennas, streams) {shapes}")
        at, number = end, number + 1
    if not found:
        raise ValueError("it has no CSI frames")
    return found


def _frame(raw: bytes) -> _Frame | None:
    """A frame with its length in front; None if it has no CSI."""
    if len(raw) < _HEADER.size:
        raise ValueError(f"it has {len(raw)} bytes, too few for a header")
    _, magic, version, count = _HEADER.unpack_from(raw)
    if magic != _MAGIC or version not in (1, 2):
        raise ValueError("its header is not of PicoScenes' version 1 or 2")
    # Since version 2 the number of packets follows, and each packet has its length in front.
    at = _HEADER.size + (2 if version == 2 else 0)
    segments, at = _segments(raw, at, count)
    packet = raw[at + 4 :] if version == 2 else raw[at:]
    if b"CSI" not in segments:
        return None
    timestamp, system_ns = _times(*segments.get(b"RxSBasic", (0, b"")))
    sender = int.from_bytes(packet[_SENDER], "big") if len(packet) >= _SENDER.stop else None
    return _Frame(decoded(*segments[b"CSI"]), timestamp, system_ns, sender)


def _segments(raw: bytes, at: int, count: int) -> tuple[dict[bytes, tuple[int, bytes]], int]:
    """Version and content of `count` segments by name, and where they end."""
    found = {}
    for number in range(count):
        end = at + 4 + int.from_bytes(raw[at : at + 4], "little")
        named = at + 5 + int.from_bytes(raw[at + 4 : at + 5], "little")
        if not named + 2 <= end <= len(raw):
            raise ValueError(f"the lengths in its segment {number} do not fit together")
        version = int.from_bytes(raw[named : named + 2], "little")
        found[raw[at + 5 : named].rstrip(b"\0")] = version, raw[named + 2 : end]
        at = end
    return found, at


def _times(version: int, basic: bytes) -> tuple[int, int | None]:
    """The device's count and the computer's nanoseconds since 1970."""
    if _BASIC_BYTES.get(version) != len(basic):
        raise ValueError(f"its RxSBasic segment is not known (version {version}, {len(basic)} bytes)")
    timestamp, system_ns = struct.unpack_from("<QQ", basic, 2)
    return timestamp, (system_ns or None) if version >= _WITH_SYSTEM_TIME else None
