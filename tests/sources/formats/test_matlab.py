from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import eye

from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture
from chachart.sources.formats.wifi.capture import WifiCapture

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


def bf_frames(count: int, antennas: int = 3) -> tuple[list[dict[str, object]], np.ndarray]:
    rng = np.random.default_rng(0)
    csi = rng.integers(-90, 90, (count, 1, antennas, 30, 2)) @ np.array([1, 1j])
    fields = {"Nrx": float(antennas), "Ntx": 1.0, "rssi_a": 40.0, "rssi_b": 41.0, "rssi_c": 42.0, "agc": 30.0}
    frames = [
        {"timestamp_low": 1000.0 * n, "perm": np.arange(1.0, antennas + 1)[None], "noise": -90.0, **fields}
        | {"rate": 256.0, "csi": csi[n]}
        for n in range(count)
    ]
    return frames, csi.transpose(0, 2, 1, 3)


def cells(frames: list[dict[str, object]]) -> np.ndarray:
    held = np.empty((len(frames), 1), object)
    held[:, 0] = frames
    return held


def struct_array(frames: list[dict[str, object]]) -> np.ndarray:
    held = np.empty((1, len(frames)), [(name, object) for name in frames[0]])
    for n, frame in enumerate(frames):
        held[0, n] = tuple(frame.values())
    return held


def assert_frames(path: Path, csi: np.ndarray) -> None:
    capture = open_capture(path)
    assert isinstance(capture, WifiCapture)
    np.testing.assert_array_equal(capture.group.csi, csi)
    np.testing.assert_array_equal(np.diff(capture.group.columns["time"]), 1_000_000)
    assert capture.group.columns["agc"].tolist() == [30] * len(csi)


@pytest.mark.parametrize(
    "nested",
    [
        lambda frames: {"csi_trace": cells(frames)},
        lambda frames: {"csi_entry": struct_array(frames)},
        lambda frames: {"walk": {"who": "x", "csi_trace": cells(frames), "label": 3.0}},
        lambda frames: {"all": cells([{"csi_trace": cells(frames)}])},
        lambda frames: {"csi_trace": cells(frames), "label": np.arange(6.0)},
    ],
)
def test_frames_of_read_bf_file_wherever_they_are(nested: Any, tmp_path: Path) -> None:
    frames, csi = bf_frames(6)
    savemat(tmp_path / "a.mat", nested(frames), do_compression=True)
    assert_frames(tmp_path / "a.mat", csi)


def put73(file: Any, group: Any, name: str, value: Any) -> None:
    """Write a variable as MATLAB v7.3 does: axes turned around, cells and arrays of structs by reference."""
    import h5py

    if isinstance(value, dict):
        made = group.create_group(name)
        made.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, item in value.items():
            put73(file, made, key, item)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        references = np.empty(value.shape, h5py.ref_dtype)
        store = file.require_group("#refs#")
        for place, item in np.ndenumerate(value):
            held = f"r{len(store)}"
            put73(file, store, held, item)
            references[place] = store[held].ref
        group.create_dataset(name, data=references.T, dtype=h5py.ref_dtype)
    elif isinstance(value, np.ndarray) and value.dtype.names:
        made = group.create_group(name)
        for key in value.dtype.names:
            put73(file, made, key, value[key])
    else:
        array = np.atleast_2d(np.asarray(value))
        if np.iscomplexobj(array):
            pairs = np.empty(array.T.shape, [("real", "f8"), ("imag", "f8")])
            pairs["real"], pairs["imag"] = array.T.real, array.T.imag
            array = pairs.T
        group.create_dataset(name, data=array.T)


@pytest.mark.parametrize(
    "nested",
    [
        lambda frames: {"csi_trace": cells(frames)},
        lambda frames: {"csi_entry": struct_array(frames)},
        lambda frames: {"walk": {"csi_trace": cells(frames), "label": 3.0}},
        lambda frames: {"csi_trace": cells(frames), "label": np.arange(6.0)},
    ],
)
def test_frames_of_read_bf_file_in_version_7_3(nested: Any, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    frames, csi = bf_frames(6)
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, value in nested(frames).items():
            put73(file, file, name, value)
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    assert_frames(tmp_path / "a.mat", csi)


def test_a_struct_with_another_csi_is_no_wifi_capture(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        put73(file, file, "data", {"csi": np.ones((5, 8, 16)) * 1j})
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    capture = open_capture(tmp_path / "a.mat")
    assert capture.variables["data/csi"].shape == (5, 8, 16)


def test_cells_that_hold_each_other_are_no_endless_walk(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        store = file.create_group("#refs#")
        round_ = store.create_dataset("r", (1000, 1), h5py.ref_dtype)
        round_[:, 0] = [round_.ref] * 1000
        file["csi_trace"] = np.array([[round_.ref]], h5py.ref_dtype)
        file["label"] = np.arange(3.0)
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    assert "label" in open_capture(tmp_path / "a.mat").variables
