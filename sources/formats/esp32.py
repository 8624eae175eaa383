"""Text of the ESP32 CSI Tool (`.csv`): one line a frame, `CSI_DATA,...,[imaginary real imaginary real ...]`.

Variables: `csi` of (frames, subcarriers), one antenna, and `time`, the board's clock in nanoseconds. Lines
that do not begin with CSI_DATA are comments.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture
from chachart.sources.formats.wifi import WifiCapture, alike, unwrapped_ns

NAME = "ESP32 .csv"

_MARK = "CSI_DATA,"
_CLOCK_COLUMN = 18


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    marked = head.startswith(_MARK.encode()) or b"\n" + _MARK.encode() in head
    return None if marked else "no line begins with CSI_DATA"


def open_capture(path: Path) -> Capture:
    """The CSI of a log.

    Raises
    ------
    SetupError
        If a line is damaged or cut short, or has other subcarriers than the first.
    """
    values: list[list[int]] = []
    clock: list[int] = []
    try:
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            if not line.startswith(_MARK):
                continue
            head, bracket, tail = line.rstrip().partition(",[")
            if not bracket or not tail.endswith("]"):
                raise ValueError(f"line {number} has no [...]")
            try:
                values.append([int(word) for word in tail[:-1].replace(",", " ").split()])
                clock.append(int(head.split(",")[_CLOCK_COLUMN]))
            except (ValueError, IndexError):
                raise ValueError(f"line {number} has something that is no number") from None
        alike([(len(row),) for row in values], "a number of values")
        pairs = np.array(values, np.int16).reshape(len(values), -1, 2)
    except (ValueError, OverflowError, OSError) as error:
        raise SetupError(f"{path} is damaged or cut short: {error}") from None
    time = unwrapped_ns(np.array(clock), bits=32, tick_ns=1000)
    arrays = {"csi": pairs[..., 1] + 1j * pairs[..., 0], "time": time}
    return WifiCapture(path, NAME, arrays, axes=("ue", "subcarrier"))
