"""Made-up captures of every format, for benchmarks of the readers: right in structure, random in value."""

from __future__ import annotations

import io
import struct
from typing import Any, cast

import numpy as np

_STATION = bytes([2, 0, 0, 0, 0, 1])
_PACKET = b"\x88\0\0\0" + b"\xff" * 6 + _STATION + bytes(8)


def made(name: str, frames: int, rng: np.random.Generator) -> bytes:
    """A capture of one of `NAMES` with so many frames."""
    return _MAKERS[name](frames, rng)


def _intel5300(frames: int, rng: np.random.Generator) -> bytes:
    records = []
    for n in range(frames):
        head = struct.pack(
            "<IHHBBBBBbBBHH",
            1000 * n & 0xFFFFFFFF,
            n & 0xFFFF,
            0,
            3,
            1,
            40,
            41,
            42,
            -90,
            30,
            0b100100,
            192,
            0x1101,
        )
        records.append(struct.pack(">HB", len(_PACKET) + 1, 0xC1) + _PACKET)
        records.append(struct.pack(">HB", 213, 0xBB) + head + rng.bytes(192))
    return b"".join(records)


def _atheros(frames: int, rng: np.random.Generator) -> bytes:
    records = []
    for n in range(frames):
        size = 56 * 3 * 2 * 20 // 8
        head = struct.pack(
            "<QHHBbBBBBBBBBBH", 1000 * n, size, 2412, 0, -95, 1, 0, 56, 3, 2, 40, 41, 42, 43, len(_PACKET)
        )
        records.append(struct.pack("<H", 25 + size + len(_PACKET)) + head + rng.bytes(size) + _PACKET)
    return b"".join(records)


def _udp(payload: bytes) -> bytes:
    datagram = struct.pack(">HHHH", 5500, 5500, 8 + len(payload), 0) + payload
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(datagram), 0, 0, 1, 17, 0, bytes(4), b"\xff" * 4)
    return b"\xff" * 6 + b"NEXMON" + b"\x08\0" + ip + datagram


def _nexmon_packets(frames: int, rng: np.random.Generator) -> list[tuple[int, bytes]]:
    found = []
    for n in range(frames):
        for core in range(2):
            head = b"\x11\x11\xce\0" + _STATION + struct.pack("<HHHH", n & 0xFFFF, core, 0xE02A, 0x65)
            found.append((n, _udp(head + rng.bytes(1024))))
    return found


def _nexmon(frames: int, rng: np.random.Generator) -> bytes:
    records = [struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)]
    for n, packet in _nexmon_packets(frames, rng):
        records.append(
            struct.pack("<IIII", 1_600_000_000 + n // 1000, n % 1000, len(packet), len(packet)) + packet
        )
    return b"".join(records)


def _block(kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def _pcapng(frames: int, rng: np.random.Generator) -> bytes:
    blocks = [_block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))]
    blocks.append(_block(1, struct.pack("<HHI", 1, 0, 0) + struct.pack("<HHB3xHH", 9, 1, 9, 0, 0)))
    for n, packet in _nexmon_packets(frames, rng):
        blocks.append(_block(6, struct.pack("<IIIII", 0, 0, n * 1000, len(packet), len(packet)) + packet))
    return b"".join(blocks)


def _feitcsi(frames: int, rng: np.random.Generator) -> bytes:
    records = []
    for n in range(frames):
        head = bytearray(272)
        struct.pack_into("<I", head, 0, 2 * 242 * 4)
        struct.pack_into("<BB", head, 46, 2, 1)
        struct.pack_into("<IxxxxII6s", head, 52, 242, 41, 39, _STATION)
        struct.pack_into("<II", head, 88, 1000 * n & 0xFFFFFFFF, 3 << 8 | 2 << 11)
        records.append(bytes(head) + rng.bytes(2 * 242 * 4))
    return b"".join(records)


def _segment(name: bytes, version: int, content: bytes) -> bytes:
    body = bytes([len(name)]) + name + struct.pack("<H", version) + content
    return struct.pack("<I", len(body)) + body


def _picoscenes(frames: int, rng: np.random.Generator) -> bytes:
    records = []
    for n in range(frames):
        basic = struct.pack("<HQQhhHBHHBBBB", 0x2000, n, 10**18 + n, 5180, 5180, 20, 1, 20, 800, 0, 1, 0, 2)
        basic += b"\1\0" + struct.pack("<5b", -95, -40, -41, -42, -43)
        head = struct.pack(
            "<HBbHQQIHBBBHBhI",
            0x2000,
            68,
            1,
            20,
            5_180_000_000,
            20_000_000,
            312_500,
            56,
            1,
            2,
            0,
            1,
            0,
            0,
            448,
        )
        segments = _segment(b"RxSBasic", 4, basic) + _segment(b"CSI", 4, head + rng.bytes(448))
        body = b"\x15\x03\x15\x20" + struct.pack("<HB", 1, 2) + segments + _PACKET
        records.append(struct.pack("<I", len(body)) + body)
    return b"".join(records)


def _esp32(frames: int, rng: np.random.Generator) -> bytes:
    lines = [b"I (300) wifi: a message"]
    for n in range(frames):
        values = ",".join(map(str, rng.integers(-128, 128, 128).tolist()))
        told = f"CSI_DATA,{n},02:00:00:00:00:01,-40,11,0,7,0,0,0,0,0,0,0,-95,0,6,0,{1000 * n},0,47,0,128,0"
        lines.append(f'{told},"[{values}]"'.encode())
    return b"\n".join(lines) + b"\n"


def _csi(frames: int, rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((frames, 4, 16, 2), np.float32).view(np.complex64)[..., 0]


def _npy(frames: int, rng: np.random.Generator) -> bytes:
    file = io.BytesIO()
    np.save(file, _csi(frames, rng))
    return file.getvalue()


def _npz(frames: int, rng: np.random.Generator) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, csi=_csi(frames, rng), time=np.arange(frames))
    return file.getvalue()


def _matlab(frames: int, rng: np.random.Generator) -> bytes:
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(cast(Any, file), {"csi": _csi(frames, rng)}, do_compression=True)
    return file.getvalue()


def _matlab_cells(frames: int, rng: np.random.Generator) -> bytes:
    from scipy.io import savemat

    cells = np.empty((frames, 1), object)
    for n in range(frames):
        pairs = rng.standard_normal((1, 3, 30, 2)).view(np.complex128)[..., 0]
        cells[n, 0] = {
            "timestamp_low": float(n),
            "Nrx": 3.0,
            "Ntx": 1.0,
            "perm": np.arange(1.0, 4),
            "csi": pairs,
        }
    file = io.BytesIO()
    savemat(cast(Any, file), {"csi_trace": cells})
    return file.getvalue()


def _hdf5(frames: int, rng: np.random.Generator) -> bytes:
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w") as opened:
        opened["csi"] = _csi(frames, rng)
    return file.getvalue()


def _matlab73(frames: int, rng: np.random.Generator) -> bytes:
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w", userblock_size=512) as opened:
        store = opened.create_group("#refs#")
        cells = np.empty((1, frames), h5py.ref_dtype)
        for n in range(frames):
            frame = store.create_group(f"f{n}")
            pairs = np.empty((30, 3, 1), [("real", "f8"), ("imag", "f8")])
            pairs["real"], pairs["imag"] = rng.integers(-90, 90, (2, 30, 3, 1))
            frame["csi"], frame["timestamp_low"] = pairs, np.full((1, 1), float(n))
            cells[0, n] = frame.ref
        opened.create_dataset("csi_trace", data=cells, dtype=h5py.ref_dtype)
    written = bytearray(file.getvalue())
    title = b"MATLAB 7.3 MAT-file, Platform: GLNXA64"
    written[: len(title)] = title
    return bytes(written)


def _tfrecord(frames: int, rng: np.random.Generator) -> bytes:
    from chachart.sources.formats.tfrecord import masked_crc

    def text(number: int, value: bytes) -> bytes:
        size = bytes([len(value) & 0x7F | 0x80, len(value) >> 7]) if len(value) > 127 else bytes([len(value)])
        return bytes([number << 3 | 2]) + size + value

    records = []
    for _ in range(frames):
        feature = text(2, text(1, rng.standard_normal(64).astype("<f4").tobytes()))
        data = text(1, text(1, text(1, b"csi") + text(2, feature)))
        length = struct.pack("<Q", len(data))
        checks = [struct.pack("<I", masked_crc(part)) for part in (length, data)]
        records.append(length + checks[0] + data + checks[1])
    return b"".join(records)


_MAKERS = {
    "intel5300": _intel5300,
    "atheros": _atheros,
    "nexmon": _nexmon,
    "nexmon pcapng": _pcapng,
    "feitcsi": _feitcsi,
    "picoscenes": _picoscenes,
    "esp32": _esp32,
    "npy": _npy,
    "npz": _npz,
    "matlab": _matlab,
    "matlab cells": _matlab_cells,
    "hdf5": _hdf5,
    "matlab 7.3 cells": _matlab73,
    "tfrecord": _tfrecord,
}
NAMES = tuple(_MAKERS)
