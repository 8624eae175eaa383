"""Captures of PicoScenes, written segment by segment from the definition of the format."""

from __future__ import annotations

import struct

import numpy as np
from wifi_captures import packed

DEVICES = {"5300": 0x5300, "9300": 0x9300, "ax200": 0x2000, "ax210": 0x2100, "usrp": 0x1234}
SYSTEM_NS = 1_700_000_000_000_000_000


def segment(name: bytes, version: int, content: bytes) -> bytes:
    body = bytes([len(name)]) + name + struct.pack("<H", version) + content
    return struct.pack("<I", len(body)) + body


def basic(version: int, n: int) -> bytes:
    """RxSBasic of frame `n`: 5 ms after the one before."""
    content = struct.pack("<HQ", 0x2000, 1000 + 5000 * n)
    content += struct.pack("<Q", SYSTEM_NS + 5_000_000 * n) if version >= 4 else b""
    content += struct.pack("<h", 5180) + (struct.pack("<h", 5180) if version == 5 else b"")
    content += struct.pack("<hHBHHBBBB", 5180, 20, 1, 20, 800, 0, 1, 0, 2) if version >= 3 else b""
    content += struct.pack("<BHHBBBB", 1, 20, 800, 0, 1, 0, 2) if version < 3 else b""
    content += (b"\1\0" if version >= 2 else b"") + struct.pack("<5b", -95, -40, -41, -42, -43)
    content += bytes(5) if version == 5 else b""
    return segment(b"RxSBasic", version, content)


def payload(device: str, frame: np.ndarray, version: int) -> bytes:
    """CSI (subcarriers, antennas, streams) as the device packs it."""
    tones, antennas, sent = frame.shape
    if device == "5300":
        pairs = np.stack([frame.real, frame.imag], -1).astype(int)
        return packed(pairs.ravel(), 8, 3, 2 * antennas * sent)
    if device == "9300":
        pairs = np.stack([frame.imag, frame.real], -1).astype(int)
        return packed(pairs.transpose(0, 2, 1, 3).ravel(), 10)
    if device == "usrp":
        kind, dtype = (b"CF\x20C", "<c8") if version == 6 else (b"CD\x40C", "<c16")
        head = b"BBv2\4" + struct.pack("<4Q", tones, sent, antennas, 1) + kind
        indices = np.arange(tones, dtype="<i2") - tones // 2
        return indices.tobytes() + head + frame.transpose(1, 2, 0).astype(dtype).tobytes()
    pairs = np.stack([frame.imag, frame.real], -1).astype("<i2")
    return pairs.transpose(1, 2, 0, 3).tobytes()


def csi_segment(
    device: str, frame: np.ndarray, version: int, *, chosen: int = 0b100100, mode: tuple[int, int] = (1, 20)
) -> bytes:
    tones, antennas, sent = frame.shape
    packet_format, bandwidth = mode
    content = struct.pack("<H", DEVICES[device]) + (b"\x45" if version >= 4 else b"")
    content += struct.pack("<bHQ", packet_format, bandwidth, 5_180_000_000)
    content += struct.pack("<QB", 5_180_000_000, 0) if version >= 5 else b""
    content += struct.pack("<QIHBBB", 20_000_000, 312_500, tones, sent, antennas, 0)
    content += struct.pack("<H", 1) if version >= 3 else b""
    content += bytes([chosen]) + (struct.pack("<h", 0) if version >= 2 else b"")
    data = payload(device, frame, version)
    return segment(b"CSI", version, content + struct.pack("<I", len(data)) + data)


def frame_of(segments: list[bytes], version: int, sender: int) -> bytes:
    packet = struct.pack("<HH6s", 0x88, 0, b"\xff" * 6) + sender.to_bytes(6, "big") + bytes(6 + 2 + 4)
    tail = struct.pack("<I", len(packet)) + packet if version == 2 else packet
    head = struct.pack("<4sHB", b"\x15\x03\x15\x20", version, len(segments))
    body = head + (struct.pack("<H", 1) if version == 2 else b"") + b"".join(segments) + tail
    return struct.pack("<I", len(body)) + body


def picoscenes(
    csi: np.ndarray,
    device: str = "ax210",
    *,
    csi_version: int = 6,
    basic_version: int = 5,
    frame_version: int = 2,
    chosen: int = 0b100100,
    mode: tuple[int, int] = (1, 20),
) -> bytes:
    """Frames (frames, subcarriers, antennas, streams); a frame without CSI comes after the first."""
    frames = []
    extra = segment(b"ExtraInfo", 1, struct.pack("<IH", 1 << 1, 40))
    for n, frame in enumerate(csi):
        written = csi_segment(device, frame, csi_version, chosen=chosen, mode=mode)
        segments = [basic(basic_version, n), extra, written]
        frames.append(frame_of(segments, frame_version, 0x0200_0000_0000 + n))
    frames.insert(1, frame_of([basic(basic_version, 0), extra], frame_version, 1))
    return b"".join(frames)
