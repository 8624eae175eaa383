"""Records of openwifi's side channel, as its board sends them by UDP.

8-byte symbols: the TSF time in microseconds, one with the frequency offset first, 56 of CSI (`i16 I, i16 Q`
and four bytes that mean nothing here), then the equaliser's. The CSI has its halves swapped. Little-endian.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.wifi.log import Group, Kind, Log, Tones

SUBCARRIERS = 56
_SYMBOL = 8
_EQUALISED = 52
_NUMBERS = (*range(-28, 0), *range(1, 29))
TONES = Tones(_NUMBERS, _NUMBERS)


def record_bytes(equalisers: int) -> int:
    """How long a record is that has the results of so many equalisers."""
    return _SYMBOL * (2 + SUBCARRIERS + equalisers * _EQUALISED)


def read(data: NDArray[np.uint8], equalisers: int = 8) -> Log:
    """The frames of whole records, bytes (N,) of datagrams."""
    size = record_bytes(equalisers)
    count = len(data) // size
    left_out = Counter({"cut short": 1} if len(data) % size else {})
    if not count:
        return Log([], left_out, "TSF, 1 MHz")
    records = data[: count * size].reshape(count, size)
    time = np.ascontiguousarray(records[:, :_SYMBOL]).view("<u8")[:, 0]
    csi = np.ascontiguousarray(records[:, 2 * _SYMBOL : (2 + SUBCARRIERS) * _SYMBOL]).view("<i2")
    parts = csi.reshape(count, SUBCARRIERS, _SYMBOL // 2)[:, :, :2].astype(np.float32)
    values = (parts[:, :, 0] + 1j * parts[:, :, 1]).astype(np.complex64)
    ascending = np.roll(values, SUBCARRIERS // 2, axis=1)[:, None, None]
    columns = {
        "time": (time % (1 << 53)).astype(np.int64) * 1000,
        "ue": np.zeros(count, np.uint64),
    }
    group = Group(Kind(1, 1, SUBCARRIERS, TONES), np.arange(count, dtype=np.int64), ascending, columns)
    return Log([group], left_out, "TSF, 1 MHz")


def encode(csi: NDArray[np.complex64], time_us: int, equalisers: int = 8) -> bytes:
    """A record of CSI (56,), ascending and within 16 bits, as the board sends it."""
    record = np.zeros((2 + SUBCARRIERS + equalisers * _EQUALISED, _SYMBOL // 2), "<i2")
    swapped = np.roll(csi, -(SUBCARRIERS // 2))
    record[2 : 2 + SUBCARRIERS, 0] = np.rint(swapped.real)
    record[2 : 2 + SUBCARRIERS, 1] = np.rint(swapped.imag)
    return time_us.to_bytes(8, "little") + record[1:].tobytes()
