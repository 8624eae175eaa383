"""A sensor's message about one Wi-Fi packet: type-length-value fields behind a type, closed by a CRC-32.

`u32 type`, then fields `u8 type, u16 length, value`; the last is the CRC of all before it. Only what charting
needs is read: who transmitted, when, at which gain, and the channel estimate of the legacy training field
(L-LTF), of which the sensor measures every second subcarrier.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from isal.isal_zlib import crc32
from numpy.typing import NDArray

from chachart.sources.live.device import CodecError

CSI_MESSAGE = 0xE4CD0BAC
TONES = np.array([k for k in range(-26, 26, 2) if k])
"""Subcarriers that carry a measured value: every second of the L-LTF, without the middle, which carries
nothing. The odd ones that the device's own tools show are interpolated."""
SUBCARRIER_SPACING_HZ = 312_500.0
UNIT_NS = 12.5
"""Unit of a packet's start within its microsecond."""
LATCH_NS = 20_800
"""The hardware latches its clock so long after a packet has begun."""

_FRAME_META, _TIMING, _ACQUIRE, _RX_CTRL, _CSI, _RX_CTRL_SHORT, _CRC = 2, 3, 4, 5, 6, 8, 255
_FIELD = struct.Struct("<BH")
_TYPE = struct.Struct("<I")
_CALIBRATION, _FIRST_WORD_INVALID = 1 << 0, 1 << 2
_FORCED, _EIGHT_BIT = 1 << 0, 1 << 1
_VALUES = 52
_RETRY = 1 << 11


@dataclass(frozen=True, slots=True, eq=False)
class SensorCsi:
    """What one antenna says of one Wi-Fi packet.

    Attributes
    ----------
    source, destination
        Addresses, as numbers: the first byte is the highest.
    sequence, retry
        Sequence control, and whether it is a repetition: with the addresses, which packet it is.
    calibration
        Whether the board sent it to itself, through its reference network.
    time_ns
        When it began by the sensor's clock, in units of half a nanosecond below: `time_half_ns / 2`.
    csi
        complex64 (25,) at `TONES`, at unit gain.
    rssi_dbm, noise_dbm
        As the radio says.
    channel, secondary
        Primary 20 MHz channel, and where the other half of a 40 MHz one is: 1 above, -1 below, 0 nowhere.
    """

    source: int
    destination: int
    sequence: int
    retry: bool
    calibration: bool
    time_half_ns: int
    csi: NDArray[np.complex64]
    rssi_dbm: int
    noise_dbm: int
    channel: int
    secondary: int

    @property
    def packet(self) -> tuple[int, int, int, bool]:
        """What the same packet has in common at all antennas."""
        return self.source, self.destination, self.sequence, self.retry


@dataclass(frozen=True, slots=True)
class _Radio:
    """What is read of the radio's own record of a packet."""

    rssi: int
    noise: int
    fft_gain: int
    rx_gain: int
    cycles: int
    channel: int
    secondary: int
    length: int
    valid: bool


def decode_message(message: bytes) -> SensorCsi | None:
    """The channel estimate in a message; None for a message of another kind.

    Raises
    ------
    CodecError
        `crc` if the checksum is missing or wrong, `truncated`, `fields` if one that is needed is missing or
        too short, `format` if it is not the 12-bit L-LTF that the source asks for, `invalid` if the radio
        says that the estimate is not valid.
    """
    if len(message) < _TYPE.size:
        raise CodecError("truncated", "a message has at least its type")
    if _TYPE.unpack_from(message)[0] != CSI_MESSAGE:
        return None
    fields = dict(_fields(message))
    try:
        return _sensor_csi(fields)
    except (KeyError, struct.error):
        raise CodecError("fields", "a field that is needed is missing or too short") from None


def _fields(message: bytes) -> Iterator[tuple[int, bytes]]:
    at = _TYPE.size
    while at + _FIELD.size <= len(message):
        kind, length = _FIELD.unpack_from(message, at)
        value = message[at + _FIELD.size : at + _FIELD.size + length]
        if len(value) < length:
            raise CodecError("truncated", f"field {kind} says {length} bytes, {len(value)} are left")
        if kind == _CRC:
            if length != 4 or _TYPE.unpack(value)[0] != crc32(message[:at]):
                raise CodecError("crc", "the checksum is wrong")
            return
        yield kind, value
        at += _FIELD.size + length
    raise CodecError("crc", "there is no checksum")


def _sensor_csi(fields: dict[int, bytes]) -> SensorCsi:
    meta = fields[_FRAME_META]
    control, flags = struct.unpack_from("<HH", meta, 12)
    retry = len(meta) >= 18 and bool(struct.unpack_from("<H", meta, 16)[0] & _RETRY)
    (clock_us,) = struct.unpack_from("<Q", fields[_TIMING])
    (acquire,) = struct.unpack_from("<H", fields[_ACQUIRE])
    radio = _long_record(fields[_RX_CTRL]) if _RX_CTRL in fields else _short_record(fields[_RX_CTRL_SHORT])
    if not radio.valid:
        raise CodecError("invalid", "the radio says that the estimate is not valid")
    if acquire & (_FORCED | _EIGHT_BIT) != _FORCED:
        raise CodecError("format", "the estimate is not the forced L-LTF of 12 bits that was asked for")
    raw = fields[_CSI]
    if min(len(raw), radio.length or len(raw)) < 2 * _VALUES:
        raise CodecError("truncated", f"{_VALUES} values take {2 * _VALUES} bytes, not {len(raw)}")
    return SensorCsi(
        source=int.from_bytes(meta[:6], "big"),
        destination=int.from_bytes(meta[6:12], "big"),
        sequence=control,
        retry=retry,
        calibration=bool(flags & _CALIBRATION),
        time_half_ns=2 * (clock_us * 1000 - LATCH_NS) + round(2 * UNIT_NS) * radio.cycles,
        csi=_coefficients(raw, radio, bool(flags & _FIRST_WORD_INVALID)),
        rssi_dbm=radio.rssi,
        noise_dbm=radio.noise,
        channel=radio.channel,
        secondary=radio.secondary,
    )


def _coefficients(raw: bytes, radio: _Radio, first_invalid: bool) -> NDArray[np.complex64]:
    """12-bit values, real and imaginary in turn, at -26, -24 ... 24; the middle is left out."""
    words = np.frombuffer(raw, "<u2", _VALUES).astype(np.int32) & 0xFFF
    values = (words - ((words & 0x800) << 1)).astype(np.float32)
    csi = values[0::2] + 1j * values[1::2]
    if first_invalid:  # four bytes are the first value: stand in for it with its neighbours' line
        csi[0] = 2 * csi[1] - csi[2]
    gain = 10 ** ((radio.rx_gain + 0.25 * radio.fft_gain) / 20)
    measured: NDArray[np.complex64] = (np.delete(csi, 13) / gain).astype(np.complex64)
    return measured


def _long_record(value: bytes) -> _Radio:
    """RX_CTRL_RAW: 16 words of bit fields, the least significant first."""
    w = struct.unpack_from("<16I", value)
    noise, _, fft_gain, rx_gain = struct.unpack_from("<4b", value, 20)
    return _Radio(
        rssi=_signed(w[0], 8),
        noise=noise,
        fft_gain=fft_gain,
        rx_gain=rx_gain,
        cycles=w[2] >> 24 & 0x7F,
        channel=w[7] & 0xFF,
        secondary=(0, 1, -1, 0)[w[7] >> 8 & 0x3],
        length=w[9] >> 16 & 0x3FF,
        valid=bool(w[9] >> 26 & 1),
    )


def _short_record(value: bytes) -> _Radio:
    """RX_CTRL_COMPRESSED."""
    rssi, noise, channel, secondary, _, _, _, cycles, length, flags = struct.unpack_from("<bbBbBBBBHH", value)
    fft_gain, rx_gain = struct.unpack_from("<bb", value, 22)
    sign = (secondary > 0) - (secondary < 0)
    return _Radio(rssi, noise, fft_gain, rx_gain, cycles & 0x7F, channel, sign, length, bool(flags & 2))


def _signed(word: int, bits: int) -> int:
    value = word & ((1 << bits) - 1)
    return value - (1 << bits) if value >> (bits - 1) else value


def encode_message(sensor: SensorCsi, rx_gain: int = 0) -> bytes:
    """A sensor's message, as the firmware writes it. `csi` is rounded to 12 bits at `rx_gain` dB.

    Raises
    ------
    ValueError
        If a value does not fit 12 bits, or the time is not a multiple of `UNIT_NS`.
    """
    full = np.insert(sensor.csi * 10 ** (rx_gain / 20), 13, 0)
    values = np.stack([full.real, full.imag], axis=-1).round().astype(np.int64).ravel()
    if np.abs(values).max() > 2047:
        raise ValueError(f"{np.abs(values).max()} does not fit 12 bits")
    clock_us, cycles = divmod(sensor.time_half_ns + 2 * LATCH_NS, 2000)
    cycles, rest = divmod(cycles, round(2 * UNIT_NS))
    if rest:
        raise ValueError(f"{sensor.time_half_ns / 2} ns is no multiple of {UNIT_NS}")
    addresses = sensor.source.to_bytes(6, "big") + sensor.destination.to_bytes(6, "big")
    meta = struct.pack("<HHH", sensor.sequence, sensor.calibration, _RETRY * sensor.retry)
    words = [0] * 16
    words[0] = sensor.rssi_dbm & 0xFF
    words[2] = cycles << 24
    words[5] = (sensor.noise_dbm & 0xFF) | (rx_gain & 0xFF) << 24
    words[7] = sensor.channel | {0: 0, 1: 1, -1: 2}[sensor.secondary] << 8
    words[9] = 1 << 12 | 2 * _VALUES << 16 | 1 << 26
    body = b"".join(
        [
            _TYPE.pack(CSI_MESSAGE),
            _field(_FRAME_META, addresses + meta),
            _field(_TIMING, struct.pack("<Q", clock_us)),
            _field(_ACQUIRE, struct.pack("<HBB", _FORCED, 0, 1 if sensor.calibration else 2)),
            _field(_RX_CTRL, struct.pack("<16I", *words)),
            _field(_CSI, (values & 0xFFF).astype("<u2").tobytes()),
        ]
    )
    return body + _field(_CRC, _TYPE.pack(crc32(body)))


def _field(kind: int, value: bytes) -> bytes:
    return _FIELD.pack(kind, len(value)) + value
