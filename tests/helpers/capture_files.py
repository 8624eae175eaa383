"""Capture files of every format, written by somebody else's library or by the definition."""

from __future__ import annotations

import struct
from pathlib import Path

import h5py
import numpy as np
from scipy.io import savemat

from chachart.sources.formats.tfrecord import masked_crc

CSI = (np.arange(24) + 1j).astype(np.complex64).reshape(4, 3, 2)
POSITION = np.arange(12, dtype=np.float32).reshape(4, 3)


def varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def field(number: int, value: bytes | int) -> bytes:
    """A protocol buffer field: a varint, or bytes with their length."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    return varint(number << 3 | 2) + varint(len(value)) + value


def tensor(array: np.ndarray) -> bytes:
    """What `tf.io.serialize_tensor` makes of float32 (type 1) or float64 (type 2)."""
    shape = b"".join(field(2, field(1, n)) for n in array.shape)
    return (
        field(1, {"float32": 1, "float64": 2}[array.dtype.name]) + field(2, shape) + field(4, array.tobytes())
    )


def example(features: dict[str, bytes]) -> bytes:
    """A `tf.train.Example`; values are encoded Features."""
    entries = [field(1, field(1, name.encode()) + field(2, value)) for name, value in features.items()]
    return field(1, b"".join(entries))


def record(data: bytes) -> bytes:
    length = struct.pack("<Q", len(data))
    return length + struct.pack("<I", masked_crc(length)) + data + struct.pack("<I", masked_crc(data))


def dichasus(csi: np.ndarray, position: np.ndarray) -> bytes:
    """Records as a DICHASUS file has them."""
    return b"".join(
        record(
            example(
                {
                    "csi": field(1, field(1, tensor(np.stack([h.real, h.imag], -1).astype(np.float32)))),
                    "pos-tachy": field(1, field(1, tensor(p.astype(np.float64)))),
                    "time": field(2, field(1, struct.pack("<f", n / 2))),
                    "counter": field(3, field(1, varint(n + 1000))),
                }
            )
        )
        for n, (h, p) in enumerate(zip(csi, position, strict=True))
    )


def write_hdf5(path: Path, matlab: bool) -> None:
    pair = np.dtype([("real", np.float32), ("imag", np.float32)])
    csi = CSI.T if matlab else CSI
    pairs = np.empty(csi.shape, pair)
    pairs["real"], pairs["imag"] = csi.real, csi.imag
    with h5py.File(path, "w", userblock_size=512 if matlab else 0) as file:
        file["H"] = pairs
        file["xyz"] = POSITION.T if matlab else POSITION
        file["#refs#/a"] = 1
    if matlab:
        with path.open("r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write(path: Path, kind: str) -> Path:
    """A capture with variables H and xyz; the name of the file says nothing of its format."""
    path.parent.mkdir(exist_ok=True)
    for old in path.parent.iterdir():
        old.unlink()
    match kind:
        case "npz":
            np.savez(path.with_suffix(".npz"), H=CSI, xyz=POSITION)
        case "npz_compressed":
            np.savez_compressed(path.with_suffix(".npz"), H=CSI, xyz=POSITION)
        case "matlab" | "matlab_compressed":
            savemat(path.with_suffix(".mat"), {"H": CSI, "xyz": POSITION}, do_compression=len(kind) > 6)
        case "hdf5" | "matlab73":
            write_hdf5(path.with_suffix(".h5"), kind == "matlab73")
    [written] = path.parent.glob(f"{path.name}.*")
    return written.rename(path.with_suffix(".dat"))
