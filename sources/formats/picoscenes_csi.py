"""The CSI segment of PicoScenes: each device's own way of packing complex numbers.

Definitions: RXS-Parsing-Core of PicoScenes, CSISegment and SignalMatrix.
"""

from __future__ import annotations

import math
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_HEADERS = {
    1: struct.Struct("<HbH20xHBBBBI"),
    2: struct.Struct("<HbH20xHBBBB2xI"),
    3: struct.Struct("<HbH20xHBBB2xB2xI"),
    4: struct.Struct("<HBbH20xHBBB2xB2xI"),
    5: struct.Struct("<HBbH29xHBBB2xB2xI"),
    6: struct.Struct("<HBbH29xHBBB2xB2xI"),
}
"""By version. Left out: frequencies, the number of CSI matrices, the offset of the subcarriers."""
_FIRST_WITH_FIRMWARE = 4
_FIRMWARE_BEFORE = 68

_FORMAT_VHT, _FORMAT_HE_SU = 2, 3
_UNUSED_AT_160_MHZ = {_FORMAT_VHT: slice(242, 256), _FORMAT_HE_SU: slice(996, 1024)}
"""Subcarriers that AX200 and AX210 put in the middle of 160 MHz by a mistake of firmware 67 and later."""
_FIRST_WITH_UNUSED = 67

_QCA_TONES = (56, 114)
_5300_TONES = 30
_MOST_SENT = 4
"""Streams of 802.11n, those sent only for sounding included."""
_MATRIX_INTEGERS = {b"BBv1": 4, b"BBv2": 8}
_MATRIX_VALUES = {b"CD\x40C": "<c16", b"CF\x20C": "<c8"}
"""Complex, double or float, bits, first axis fastest."""


class _Info(NamedTuple):
    device: int
    firmware: int
    format: int
    bandwidth_mhz: int
    tones: int
    sent: int
    antennas: int
    extra: int
    chosen: int
    length: int


def decoded(version: int, segment: bytes) -> NDArray[Any]:
    """CSI (subcarriers, antennas, streams) of a segment's content.

    Raises
    ------
    ValueError
        If the version or the device is not known, or the lengths do not fit together.
    """
    header = _HEADERS.get(version)
    if header is None:
        raise ValueError(f"version {version} of the CSI segment is not known")
    if len(segment) < header.size:
        raise ValueError(f"its CSI segment has {len(segment)} bytes, too few for a header")
    device, *fields = header.unpack_from(segment)
    firmware = fields.pop(0) if version >= _FIRST_WITH_FIRMWARE else _FIRMWARE_BEFORE
    info = _Info(device, firmware, *fields)
    decode = _DEVICES.get(device)
    if decode is None:
        raise ValueError(f"the CSI of device {device:#06x} is not known")
    payload = segment[header.size : header.size + info.length]
    shape = info.tones, info.antennas, info.sent
    if len(payload) < info.length or 0 in shape:
        raise ValueError(f"{len(payload)} of {info.length} bytes of CSI for {shape} (subcarriers, ...)")
    return decode(payload, info)


def _misfit(payload: bytes, info: _Info) -> ValueError:
    shape = info.tones, info.antennas, info.sent + info.extra
    return ValueError(f"{len(payload)} bytes of CSI do not fit {shape} (subcarriers, antennas, streams)")


def _bits(payload: bytes, count: int) -> NDArray[np.uint8]:
    return np.unpackbits(np.frombuffer(payload, np.uint8), bitorder="little", count=count)


def _complex(real: NDArray[Any], imag: NDArray[Any]) -> NDArray[np.complex64]:
    values = np.empty(real.shape, np.complex64)
    values.real, values.imag = real, imag
    return values


def _intel5300(payload: bytes, info: _Info) -> NDArray[Any]:
    """Per subcarrier three unused bits, then I and Q of 8 bits for each antenna and stream."""
    sent = (len(payload) - 12) // 60 // info.antennas
    if info.tones != _5300_TONES or info.antennas > 3 or not 1 <= sent <= _MOST_SENT:
        raise _misfit(payload, info)
    width = 3 + 16 * info.antennas * sent
    bits = _bits(payload, _5300_TONES * width).reshape(_5300_TONES, width)[:, 3:]
    octets = np.packbits(bits.reshape(-1, 8), axis=1, bitorder="little").view(np.int8)
    iq = octets.reshape(_5300_TONES, info.antennas, sent, 2)
    # Chain n received on antenna (chosen >> 2n) & 3: put them in the order of the antennas.
    order = np.argsort([info.chosen >> 2 * n & 3 for n in range(info.antennas)], kind="stable")
    return _complex(iq[..., 0], iq[..., 1])[:, order]


def _qca9300(payload: bytes, info: _Info) -> NDArray[Any]:
    """Q and I of 10 bits for each subcarrier, stream and antenna."""
    sent = len(payload) * 8 // (20 * info.tones * info.antennas)
    if info.tones not in _QCA_TONES or info.antennas > 3 or not 1 <= sent <= _MOST_SENT:
        raise _misfit(payload, info)
    bits = _bits(payload, 20 * info.tones * sent * info.antennas).reshape(-1, 10)
    values = ((bits @ (1 << np.arange(10))) ^ 512) - 512
    qi = values.reshape(info.tones, sent, info.antennas, 2).transpose(0, 2, 1, 3)
    return _complex(qi[..., 1], qi[..., 0])


def _iwlmvm(payload: bytes, info: _Info) -> NDArray[Any]:
    """Q and I of 16 bits for each antenna, stream and subcarrier."""
    if len(payload) != 4 * info.antennas * info.sent * info.tones:
        raise _misfit(payload, info)
    qi = np.frombuffer(payload, "<i2").reshape(info.antennas, info.sent, info.tones, 2)
    unused = _UNUSED_AT_160_MHZ.get(info.format)
    if unused and info.bandwidth_mhz == 160 and info.firmware >= _FIRST_WITH_UNUSED:
        qi = np.delete(qi, unused, axis=2)
    return _complex(qi[..., 1], qi[..., 0]).transpose(2, 0, 1)


def _usrp(payload: bytes, info: _Info) -> NDArray[Any]:
    """Numbers of the subcarriers, then a matrix that says its own axes and type."""
    matrix = payload[2 * info.tones :]
    size = _MATRIX_INTEGERS.get(matrix[:4], 0)
    at = 5 + size * int.from_bytes(matrix[4:5], "little")
    lengths = [int.from_bytes(matrix[n : n + size], "little") for n in range(5, at, size or 1)]
    dtype = np.dtype(_MATRIX_VALUES.get(matrix[at : at + 4], "V"))
    shape = info.tones, info.sent + info.extra, info.antennas
    values = matrix[at + 4 :]
    fits = math.prod(lengths) == math.prod(shape) and len(values) == math.prod(shape) * dtype.itemsize
    if not size or dtype.kind != "c" or not fits or (*lengths, 1, 1)[:3] != shape:
        raise _misfit(payload, info)
    return np.frombuffer(values, dtype).reshape(shape, order="F").transpose(0, 2, 1)


_DEVICES = {0x5300: _intel5300, 0x9300: _qca9300, 0x2000: _iwlmvm, 0x2100: _iwlmvm, 0x1234: _usrp}
