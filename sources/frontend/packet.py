"""The front-end packet as bytes: pure functions, no ports. PACKET.md beside this file has it byte by byte.

Nothing is trusted before its length and its CRC-32 have been checked, and samples are views of the packet, so
a decoder never allocates more than the packet it was given.
"""

from __future__ import annotations

import enum
import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from isal.isal_zlib import crc32
from numpy.typing import NDArray

VERSION = 1
MAX_SERIAL = 16

_HEADER = struct.Struct("<BBBxIQ")  # version, type, sample format (CSI only), sequence, device time
_CSI = struct.Struct("<QHHf")  # UE, antennas, subcarriers, scale
_HELLO = struct.Struct(
    f"<HHfdd{MAX_SERIAL}s"
)  # antennas, subcarriers, element spacing, carrier, spacing, serial
_ELEMENT = struct.Struct("<3f")  # after a hello, one for each antenna or none at all
_CRC = struct.Struct("<I")

MIN_PACKET_BYTES = _HEADER.size + _CRC.size


class PacketError(ValueError):
    """Bytes that are no packet. `reason` is a short word to count them by."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason


class PacketType(enum.IntEnum):
    """Second byte of every packet."""

    CSI = 1
    HELLO = 2
    HEARTBEAT = 3


class SampleFormat(enum.IntEnum):
    """How one real number (I or Q) is sent."""

    INT8 = 0
    INT16 = 1
    FLOAT32 = 2

    @property
    def dtype(self) -> np.dtype[Any]:
        """The numpy type of it, little-endian."""
        return _DTYPES[self]

    @property
    def full_scale(self) -> float:
        """The largest magnitude it is used for; both signs can hold it."""
        return (127.0, 32767.0, 1.0)[self]


_DTYPES: dict[SampleFormat, np.dtype[Any]] = {
    SampleFormat.INT8: np.dtype("i1"),
    SampleFormat.INT16: np.dtype("<i2"),
    SampleFormat.FLOAT32: np.dtype("<f4"),
}
_FORMATS = {dtype: fmt for fmt, dtype in _DTYPES.items()}


@dataclass(frozen=True, slots=True, eq=False)
class CsiPacket:
    """One frame: the channel of one UE on all antennas and subcarriers.

    Attributes
    ----------
    seq
        Number of this frame, counting from 0 modulo 2**32.
    time_ns
        Device time, nanoseconds since any epoch; 0 if the device has no clock.
    ue
        Whatever number the front-end gives the UE, 64 bits.
    samples
        int8, int16 or float32 (antennas, subcarriers, 2): I and Q. The channel is `scale * (I + jQ)`.
    scale
        Positive and finite.
    """

    seq: int
    time_ns: int
    ue: int
    samples: NDArray[Any]
    scale: float

    @property
    def csi(self) -> NDArray[np.complex64]:
        """complex64 (antennas, subcarriers)."""
        scaled = self.samples.astype(np.float32) * np.float32(self.scale)
        return scaled.view(np.complex64)[..., 0]

    @classmethod
    def quantise(
        cls, seq: int, time_ns: int, ue: int, csi: NDArray[np.complex64], fmt: SampleFormat
    ) -> CsiPacket:
        """The packet of a frame, scaled so that the largest I or Q uses the format's whole range.

        `csi` is complex64 (antennas, subcarriers). float32 is sent as it is, with scale 1.
        """
        pairs = np.ascontiguousarray(csi, np.complex64).view(np.float32).reshape(*csi.shape, 2)
        if fmt is SampleFormat.FLOAT32:
            return cls(seq, time_ns, ue, pairs, 1.0)
        scale = np.float32(float(np.abs(pairs).max()) / fmt.full_scale)
        if not scale > 0:
            scale = np.float32(1.0)
        limited = np.clip(np.rint(pairs / scale), -fmt.full_scale, fmt.full_scale)
        return cls(seq, time_ns, ue, limited.astype(fmt.dtype), float(scale))


@dataclass(frozen=True, slots=True)
class Hello:
    """Who a front-end is and what it measures, sent when it starts and every few seconds.

    `seq` is the number its next CSI packet will have. `element_spacing_m` is 0 where it does not know.
    `elements` are positions (antennas, 3) along right, up and normal, in metres; None of a uniform line, or
    where it does not know.
    """

    seq: int
    time_ns: int
    antennas: int
    subcarriers: int
    carrier_hz: float
    subcarrier_spacing_hz: float
    element_spacing_m: float
    serial: str
    elements: tuple[tuple[float, float, float], ...] | None = None


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """A sign of life. `seq` is the number the next CSI packet will have, so that losses show without one."""

    seq: int
    time_ns: int


Packet = CsiPacket | Hello | Heartbeat


def csi_packet_bytes(antennas: int, subcarriers: int, fmt: SampleFormat) -> int:
    """Length of a CSI packet in bytes."""
    return _HEADER.size + _CSI.size + antennas * subcarriers * 2 * fmt.dtype.itemsize + _CRC.size


def max_packet_bytes(antennas: int, subcarriers: int) -> int:
    """Length of the longest packet that a front-end of this shape sends."""
    hello = _HEADER.size + _HELLO.size + antennas * _ELEMENT.size + _CRC.size
    return max(hello, csi_packet_bytes(antennas, subcarriers, SampleFormat.FLOAT32))


def encode(packet: Packet) -> bytes:
    """The packet as bytes, CRC included.

    Raises
    ------
    ValueError
        If a field does not fit its place.
    """
    try:
        if isinstance(packet, CsiPacket):
            fmt = _FORMATS[packet.samples.dtype]
            antennas, subcarriers, pair = packet.samples.shape
            if pair != 2:
                raise ValueError(f"samples must be (antennas, subcarriers, 2), not {packet.samples.shape}")
            head = _HEADER.pack(VERSION, PacketType.CSI, fmt, packet.seq, packet.time_ns)
            body = _CSI.pack(packet.ue, antennas, subcarriers, packet.scale) + packet.samples.tobytes()
        elif isinstance(packet, Hello):
            head = _HEADER.pack(VERSION, PacketType.HELLO, 0, packet.seq, packet.time_ns)
            body = _HELLO.pack(
                packet.antennas,
                packet.subcarriers,
                packet.element_spacing_m,
                packet.carrier_hz,
                packet.subcarrier_spacing_hz,
                packet.serial.encode("ascii")[:MAX_SERIAL],
            )
            body += b"".join(_ELEMENT.pack(*place) for place in packet.elements or ())
        else:
            head = _HEADER.pack(VERSION, PacketType.HEARTBEAT, 0, packet.seq, packet.time_ns)
            body = b""
    except (struct.error, KeyError, OverflowError) as error:
        raise ValueError(f"does not fit into a packet: {error}") from None
    raw = head + body
    return raw + _CRC.pack(crc32(raw))


def decode(raw: bytes | bytearray | memoryview) -> Packet:
    """The packet that `raw` holds; the samples of a CSI packet are a read-only view of it.

    Raises
    ------
    PacketError
        With reason `short`, `crc`, `version`, `type`, `size`, `format`, `scale`, `samples` or `field`.
    """
    view = memoryview(raw).toreadonly()
    if len(view) < MIN_PACKET_BYTES:
        raise PacketError("short", f"{len(view)} bytes, a packet has at least {MIN_PACKET_BYTES}")
    if crc32(view[: -_CRC.size]) != _CRC.unpack(view[-_CRC.size :])[0]:
        raise PacketError("crc", f"the CRC-32 of a packet of {len(view)} bytes does not match")
    version, kind, fmt, seq, time_ns = _HEADER.unpack_from(view)
    if version != VERSION:
        raise PacketError("version", f"version must be {VERSION}, not {version}")
    if time_ns >= 1 << 63:
        raise PacketError("field", f"device time {time_ns} ns is beyond 2**63")
    body = view[_HEADER.size : -_CRC.size]
    if kind == PacketType.CSI:
        return _decode_csi(body, fmt, seq, time_ns)
    if kind == PacketType.HELLO:
        return _decode_hello(body, seq, time_ns)
    if kind == PacketType.HEARTBEAT:
        if len(body):
            raise PacketError("size", f"a heartbeat has no body, not one of {len(body)} bytes")
        return Heartbeat(seq, time_ns)
    raise PacketError("type", f"type must be 1, 2 or 3, not {kind}")


def _decode_csi(body: memoryview, fmt: int, seq: int, time_ns: int) -> CsiPacket:
    if fmt not in (0, 1, 2):
        raise PacketError("format", f"sample format must be 0, 1 or 2, not {fmt}")
    if len(body) < _CSI.size:
        raise PacketError("size", f"a CSI packet's body has at least {_CSI.size} bytes, not {len(body)}")
    ue, antennas, subcarriers, scale = _CSI.unpack_from(body)
    dtype = SampleFormat(fmt).dtype
    expected = antennas * subcarriers * 2 * dtype.itemsize
    if expected == 0 or len(body) - _CSI.size != expected:
        raise PacketError(
            "size",
            f"{antennas} x {subcarriers} samples take {expected} bytes, not {len(body) - _CSI.size}",
        )
    if not (math.isfinite(scale) and scale > 0):
        raise PacketError("scale", f"scale must be positive, not {scale}")
    samples = np.frombuffer(body, dtype, offset=_CSI.size).reshape(antennas, subcarriers, 2)
    if fmt == SampleFormat.FLOAT32 and not np.isfinite(samples).all():
        raise PacketError("samples", "not all samples are finite")
    return CsiPacket(seq, time_ns, ue, samples, scale)


def _decode_hello(body: memoryview, seq: int, time_ns: int) -> Hello:
    if len(body) < _HELLO.size:
        raise PacketError("size", f"a hello's body has {_HELLO.size} bytes or more, not {len(body)}")
    antennas, subcarriers, spacing, carrier, subcarrier_spacing, serial = _HELLO.unpack_from(body)
    numbers_fit = (
        antennas > 0
        and subcarriers > 0
        and all(math.isfinite(v) and v > 0 for v in (carrier, subcarrier_spacing))
        and math.isfinite(spacing)
        and spacing >= 0
    )
    text = serial.rstrip(b"\0")
    rest = body[_HELLO.size :]
    if len(rest) not in (0, antennas * _ELEMENT.size):
        raise PacketError("size", f"a hello has {antennas} elements of {_ELEMENT.size} bytes or none")
    elements = tuple(_ELEMENT.iter_unpack(rest)) or None
    numbers_fit = numbers_fit and all(math.isfinite(v) for place in elements or () for v in place)
    if not numbers_fit or not all(32 <= c < 127 for c in text):
        raise PacketError("field", "a hello's numbers must be positive and its serial number printable ASCII")
    return Hello(
        seq,
        time_ns,
        antennas,
        subcarriers,
        carrier,
        subcarrier_spacing,
        spacing,
        text.decode("ascii"),
        elements,
    )
