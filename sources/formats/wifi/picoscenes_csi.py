"""The CSI segment of PicoScenes: each device's own way of packing complex numbers.

Definitions: RXS-Parsing-Core of PicoScenes, CSISegment and SignalMatrix.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.wifi import tones
from chachart.sources.formats.wifi.bits import complex_of_16, imaginary_first_of_10, pairs_of_8
from chachart.sources.formats.wifi.log import Kind, Tones

_HEADERS = {
    1: struct.Struct("<HbHQ8xIHBBBBI"),
    2: struct.Struct("<HbHQ8xIHBBBBhI"),
    3: struct.Struct("<HbHQ8xIHBBB2xBhI"),
    4: struct.Struct("<HBbHQ8xIHBBB2xBhI"),
    5: struct.Struct("<HBbHQ9x8xIHBBB2xBhI"),
    6: struct.Struct("<HBbHQ9x8xIHBBB2xBhI"),
}
"""By version. Left out: the sampling rate, a second carrier, the number of CSI matrices."""
_FIRST_WITH_FIRMWARE, _FIRST_WITH_OFFSET = 4, 2
_FIRMWARE_BEFORE = 68

_FORMATS = ("nonht", "ht", "vht", "he", "he_mu", "eht")
_STANDARDS = {"nonht": "legacy", "he_mu": "he", "eht": "he"}
"""Whose subcarriers a format has, where it is not its own name."""
_UNUSED_AT_160_MHZ = {"vht": slice(242, 256), "he": slice(996, 1024)}
"""Subcarriers that AX200 and AX210 put in the middle of 160 MHz by a mistake of firmware 67 and later."""
_FIRST_WITH_UNUSED = 67

INTEL5300, QCA9300, AX200, AX210, USRP = 0x5300, 0x9300, 0x2000, 0x2100, 0x1234
_QCA_TONES = (56, 114)
_5300_TONES = 30
_MOST_SENT = 4
"""Streams of 802.11n, those sent only for sounding included."""
_ANTENNAS = "ABCD"
_MATRIX_INTEGERS = {b"BBv1": 4, b"BBv2": 8}
_MATRIX_VALUES = {b"CD\x40C": "<c16", b"CF\x20C": "<c8"}
"""Complex, double or float, bits, first axis fastest."""

Raw = NDArray[np.uint8]
Decoded = tuple[Kind, NDArray[np.complex64]]


class _Info(NamedTuple):
    device: int
    firmware: int
    format: int
    bandwidth_mhz: int
    carrier_hz: int
    spacing_hz: int
    tones: int
    sent: int
    antennas: int
    extra: int
    chosen: int
    offset: int
    length: int

    @property
    def packet_format(self) -> str:
        return _FORMATS[self.format] if 0 <= self.format < len(_FORMATS) else ""


def header_bytes(version: int) -> int | None:
    """Bytes of the header of a CSI segment; None for a version that is not known."""
    header = _HEADERS.get(version)
    return None if header is None else header.size


def device_of(header: bytes) -> int:
    """The device in such a header."""
    return int.from_bytes(header[:2], "little")


def decoded(version: int, header: bytes, rows: Raw) -> Decoded:
    """Kind and CSI (F, antennas, streams, subcarriers) of F segments with one header.

    `rows` (F, n) holds what follows the headers.

    Raises
    ------
    ValueError
        If the device is not known, or the lengths do not fit together.
    """
    device, *fields = _HEADERS[version].unpack(header)
    if version < _FIRST_WITH_FIRMWARE:
        fields.insert(0, _FIRMWARE_BEFORE)
    if version < _FIRST_WITH_OFFSET:
        fields.insert(-1, 0)
    info = _Info(device, *fields)
    decode = _DEVICES.get(device)
    if decode is None:
        raise ValueError(f"the CSI of device {device:#06x} is not known")
    if info.length > rows.shape[1] or 0 in (info.tones, info.antennas, info.sent):
        raise _misfit(rows.shape[1], info)
    return decode(rows[:, : info.length], info)


def _misfit(length: int, info: _Info) -> ValueError:
    shape = info.tones, info.antennas, info.sent + info.extra
    return ValueError(f"{length} bytes of CSI do not fit {shape} (subcarriers, antennas, streams)")


def _kind(info: _Info, sent: int, numbers: Tones, names: tuple[str, ...] = ()) -> Kind:
    count = len(numbers.numbers) if numbers.numbers else info.tones
    return Kind(
        info.antennas,
        sent,
        count,
        numbers,
        names,
        float(info.carrier_hz) or None,
        info.bandwidth_mhz * 1e6 or None,
        packet_format=info.packet_format,
    )


def _moved(numbers: Tones, offset: int) -> Tones:
    if not offset or numbers.numbers is None:
        return numbers
    moved, used, weak = (tuple(n + offset for n in part or ()) for part in numbers[:3])
    return Tones(moved, used, weak, numbers.spacing_hz)


def _standard(info: _Info, count: int, weak_pilots: bool) -> Tones:
    """The subcarriers by the packet's format, whose bandwidth may be less than the channel's."""
    packet_format = _STANDARDS.get(info.packet_format, info.packet_format)
    found = Tones(None, spacing_hz=float(info.spacing_hz) or None)
    for mhz in (info.bandwidth_mhz, 20, 40, 80, 160):
        if count == len(tones.carrying(packet_format, mhz)):
            found = tones.standard(packet_format, mhz, count, weak_pilots)
            break
    return _moved(found, info.offset)


def _intel5300(rows: Raw, info: _Info) -> Decoded:
    """Per subcarrier three unused bits, then I and Q of 8 bits for each antenna and stream."""
    sent = (rows.shape[1] - 12) // 60 // info.antennas
    if info.tones != _5300_TONES or info.antennas > 3 or not 1 <= sent <= _MOST_SENT:
        raise _misfit(rows.shape[1], info)
    pairs = pairs_of_8(rows, _5300_TONES, 3, info.antennas * sent)
    iq = pairs.reshape(len(rows), _5300_TONES, info.antennas, sent, 2)
    # Chain n received on antenna (chosen >> 2n) & 3: put them in the order of the antennas.
    antenna = [info.chosen >> 2 * n & 3 for n in range(info.antennas)]
    order = np.argsort(antenna, kind="stable").tolist()
    csi = np.empty((len(rows), info.antennas, sent, _5300_TONES), np.complex64)
    for place, chain in enumerate(order):
        for stream in range(sent):
            csi.real[:, place, stream], csi.imag[:, place, stream] = iq[:, :, chain, stream].transpose(
                2, 0, 1
            )
    numbers = _moved(tones.intel5300(info.bandwidth_mhz), info.offset)
    return _kind(info, sent, numbers, tuple(_ANTENNAS[antenna[n]] for n in order)), csi


def _qca9300(rows: Raw, info: _Info) -> Decoded:
    """Q and I of 10 bits for each subcarrier, stream and antenna."""
    sent = rows.shape[1] * 8 // (20 * info.tones * info.antennas)
    if info.tones not in _QCA_TONES or info.antennas > 3 or not 1 <= sent <= _MOST_SENT:
        raise _misfit(rows.shape[1], info)
    values = imaginary_first_of_10(rows, info.tones * sent * info.antennas)
    csi = values.reshape(len(rows), info.tones, sent, info.antennas).transpose(0, 3, 2, 1)
    return _kind(info, sent, _standard(info, info.tones, weak_pilots=False)), csi


def _iwlmvm(rows: Raw, info: _Info) -> Decoded:
    """Q and I of 16 bits for each antenna, stream and subcarrier."""
    if rows.shape[1] != 4 * info.antennas * info.sent * info.tones:
        raise _misfit(rows.shape[1], info)
    csi = complex_of_16(rows, imaginary_first=True)
    csi = csi.reshape(len(rows), info.antennas, info.sent, info.tones)
    unused = _UNUSED_AT_160_MHZ.get(info.packet_format)
    if unused and info.bandwidth_mhz == 160 and info.firmware >= _FIRST_WITH_UNUSED:
        csi = np.delete(csi, unused, axis=3)
    count = csi.shape[3]
    kind = _kind(info._replace(tones=count), info.sent, _standard(info, count, weak_pilots=True))
    return kind, csi


def _usrp(rows: Raw, info: _Info) -> Decoded:
    """Numbers of the subcarriers, then a matrix that says its own axes and type; the same in all rows."""
    index, matrix = rows[:, : 2 * info.tones], rows[:, 2 * info.tones :]
    head = matrix[0].tobytes()[: 5 + 8 * 255 + 4]
    size = _MATRIX_INTEGERS.get(head[:4], 0)
    at = 5 + size * (head[4] if len(head) > 4 else 0)
    lengths = [int.from_bytes(head[n : n + size], "little") for n in range(5, at, size or 1)]
    dtype = np.dtype(_MATRIX_VALUES.get(head[at : at + 4], "V"))
    sent = info.sent + info.extra
    shape = info.tones, sent, info.antennas
    values = matrix[:, at + 4 :]
    fits = math.prod(lengths) == math.prod(shape) and values.shape[1] == math.prod(shape) * dtype.itemsize
    same = (matrix[:, : at + 4] == matrix[0, : at + 4]).all() and (index == index[0]).all()
    if not size or dtype.kind != "c" or not fits or (*lengths, 1, 1)[:3] != shape or not same:
        raise _misfit(rows.shape[1], info)
    numbers = np.ascontiguousarray(index[0]).view("<i2").astype(np.int64)
    order = np.argsort(numbers, kind="stable")
    csi = np.ascontiguousarray(values).view(dtype).reshape(len(rows), info.antennas, sent, info.tones)
    found = tuple((numbers[order] + info.offset).tolist())
    if len(set(found)) != len(found):
        raise _misfit(rows.shape[1], info)
    with np.errstate(over="ignore", invalid="ignore"):
        whole = csi[..., order].astype(np.complex64)
    of = Tones(found, found, (), float(info.spacing_hz) or None)
    return _kind(info, sent, of), whole


_DEVICES: dict[int, Callable[[Raw, _Info], Decoded]] = {
    INTEL5300: _intel5300,
    QCA9300: _qca9300,
    AX200: _iwlmvm,
    AX210: _iwlmvm,
    USRP: _usrp,
}
