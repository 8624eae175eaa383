from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import eye

from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture

RNG = np.random.default_rng(1)
NUMBERS = {
    "double": RNG.standard_normal((3, 4)),
    "single": RNG.standard_normal((2, 3, 4)).astype(np.float32),
    "whole": np.arange(300.0).reshape(3, 100),
    "complex": RNG.standard_normal((5, 2, 2)).view(np.complex128),
    "complex_single": RNG.standard_normal((5, 2)).astype(np.float32).view(np.complex64),
    "int8": RNG.integers(-128, 127, (3, 3), np.int8),
    "uint16": RNG.integers(0, 2**16, (1, 3), np.uint16),
    "int64": np.array([[-(2**62) - 1]]),
    "uint64": np.array([[2**63 + 1]], np.uint64),
    "logical": np.array([[True, False]]),
    "scalar": np.array([[7.5]]),
    "empty": np.zeros((0, 3)),
}
OTHERS = {
    "text": "abc",
    "cell": np.array([1, "b"], object),
    "structure": {"a": 1, "b": {"c": 2}},
    "sparse": eye(3).tocsc(),
}


@pytest.mark.parametrize("compressed", [False, True])
def test_every_kind_of_number(tmp_path: Path, compressed: bool) -> None:
    savemat(tmp_path / "a.mat", NUMBERS | OTHERS, do_compression=compressed)
    capture = open_capture(tmp_path / "a.mat")
    assert set(capture.variables) == set(NUMBERS)
    for name, value in NUMBERS.items():
        np.testing.assert_array_equal(capture.read(name), value)
        assert capture.variables[name].shape == value.shape
    assert capture.read("complex_single").dtype == np.complex64
    assert "complex: complex float64 (5, 2, 1)" in capture.listing()


def big_endian() -> bytes:
    """An array as a big-endian machine wrote it: 2 x 3 int16, and a name that fits into its tag."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    parts = element(6, struct.pack(">II", 10, 0)) + element(5, struct.pack(">ii", 2, 3))
    parts += struct.pack(">HH", 1, 1) + b"H\0\0\0" + element(3, np.arange(6, dtype=">i2").tobytes())
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + element(14, parts)


def test_a_file_of_a_big_endian_machine(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(big_endian())
    values = open_capture(tmp_path / "a.mat").read("H")
    np.testing.assert_array_equal(values, [[0, 2, 4], [1, 3, 5]])


def compressed(data: bytes) -> bytes:
    packed = zlib.compress(data)
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (big_endian()[:-9], "does not fit"),
        (big_endian()[:-1] + b"\0\0\0\0", "ends within a tag"),
        (big_endian().replace(struct.pack(">ii", 2, 3), struct.pack(">ii", 2, 9)), "holds 12 bytes of"),
        (big_endian().replace(struct.pack(">ii", 2, 3), struct.pack(">ii", -2, -3)), r"shape \(-2, -3\)"),
        (compressed(struct.pack("<II", 14, 2**31)), "claim to be 2147483648"),
        (compressed(struct.pack("<II", 14, 64) + bytes(8)), "does not fit"),
        (compressed(struct.pack("<II", 14, 8) + bytes(80)), "too early or too late"),
        (compressed(struct.pack("<II", 1, 0)), "without numeric arrays"),
    ],
)
def test_what_is_wrong_is_told(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "a.mat").write_bytes(data)
    with pytest.raises(SetupError, match=words):
        open_capture(tmp_path / "a.mat").read("H")


def test_a_file_without_numbers(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", OTHERS)
    with pytest.raises(SetupError, match="without numeric arrays"):
        open_capture(tmp_path / "a.mat")
