"""Frames of heimdall, the data acquisition of KrakenSDR: a header of 1024 bytes, then IQ samples by channel.

The header is a C structure with natural alignment, little-endian: two gaps, before the 64-bit numbers.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.sources.live.device import CodecError

SYNC = 0x2BF7B95A
HEADER_BYTES = 1024
DATA, DUMMY, CALIBRATION = 0, 1, 3
"""Types of frames: samples, nothing, and samples of the built-in noise source."""
TRACKING = 6
MOST_CHANNELS = 32
MOST_SAMPLES = 1 << 24
START, NEXT, QUIT = b"streaming", b"IQDownload", b"q"
"""What a client sends: for the first frame, for each further one, and to end."""

_HEADER = struct.Struct("<II16sIII4xQQQI4xQIIQIII32IIIII192II")
assert _HEADER.size == HEADER_BYTES


@dataclass(frozen=True, slots=True)
class Header:
    """What is said of a frame.

    Attributes
    ----------
    type
        `DATA`, `DUMMY`, `CALIBRATION` or another.
    channels, samples, depth_bits
        M, N, and bits of one real number.
    centre_hz, rate_hz
        Tuned frequency and samples a second.
    time_ns
        Nanoseconds since the Unix epoch, to a millisecond.
    index
        Number of the frame.
    overdrive
        A bit a channel whose converter was driven too far.
    delay_synchronous, iq_synchronous
        Whether the channels are aligned in time, and in phase.
    """

    type: int
    channels: int
    samples: int
    depth_bits: int
    centre_hz: int
    rate_hz: int
    time_ns: int
    index: int
    overdrive: int
    delay_synchronous: bool
    iq_synchronous: bool

    @property
    def payload_bytes(self) -> int:
        """Bytes of samples behind the header."""
        return 0 if self.type == DUMMY else self.channels * self.samples * 2 * self.depth_bits // 8

    @property
    def unusable(self) -> str | None:
        """Why no direction can be taken from the frame; None if one can."""
        if self.type != DATA:
            return {DUMMY: "dummy", CALIBRATION: "calibrating"}.get(self.type, "frame_type")
        if not (self.delay_synchronous and self.iq_synchronous):
            return "not_synchronous"
        return "overdrive" if self.overdrive else None


def decode_header(data: bytes) -> Header:
    """The header in 1024 bytes.

    Raises
    ------
    CodecError
        `sync` if it does not begin as one, `size` if it says what cannot be.
    """
    if len(data) != HEADER_BYTES or data[:4] != struct.pack("<I", SYNC):
        raise CodecError("sync", "a heimdall frame begins with 0x2BF7B95A")
    (
        _, kind, _, _, channels, _, centre, _, rate, samples, time_ms, _, index, _, _, depth, overdrive, *rest
    ) = _HEADER.unpack(data)  # fmt: skip
    header = Header(
        type=kind,
        channels=channels,
        samples=samples,
        depth_bits=depth,
        centre_hz=centre,
        rate_hz=rate,
        time_ns=time_ms * 1_000_000,
        index=index,
        overdrive=overdrive,
        delay_synchronous=bool(rest[32]),
        iq_synchronous=bool(rest[33]),
    )
    if kind != DUMMY and not (0 < channels <= MOST_CHANNELS and 0 < samples <= MOST_SAMPLES and depth == 32):
        raise CodecError("size", f"{channels} channels of {samples} samples of {depth} bits")
    if time_ms > 1 << 43 or not 0 < rate <= 1 << 40 or centre > 1 << 40:
        raise CodecError("size", f"time {time_ms} ms, {rate} samples/s at {centre} Hz")
    return header


def decode_samples(header: Header, payload: bytes) -> NDArray[np.complex64]:
    """The samples (M, N) behind a header; `payload` has its `payload_bytes`."""
    return np.frombuffer(payload, "<c8").reshape(header.channels, header.samples)


def encode_frame(header: Header, samples: NDArray[np.complex64]) -> bytes:
    """A frame as heimdall sends it; samples (M, N) count for anything but a dummy frame."""
    head = _HEADER.pack(
        SYNC, header.type, b"simulated", 0, header.channels, 0,
        header.centre_hz, header.rate_hz, header.rate_hz, header.samples,
        header.time_ns // 1_000_000, header.index, header.index, 0, 0, header.depth_bits,
        header.overdrive, *[0] * 32, header.delay_synchronous, header.iq_synchronous, TRACKING,
        header.type == CALIBRATION, *[0] * 192, 7,
    )  # fmt: skip
    return head + samples.astype("<c8").tobytes() if header.payload_bytes else head
