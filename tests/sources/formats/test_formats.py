from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from capture_files import CSI, POSITION, write
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture

KINDS = ["npz", "npz_compressed", "matlab", "matlab_compressed", "hdf5", "matlab73"]
Make = Callable[[str], Path]


@pytest.fixture
def capture_file(tmp_path: Path) -> Make:
    """Writes a capture of some kind into a folder of its own."""
    return lambda kind: write(tmp_path / kind / "capture", kind)


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gives_back_what_was_written(capture_file: Make, kind: str) -> None:
    capture = open_capture(capture_file(kind))
    assert set(capture.variables) == {"H", "xyz"}
    assert capture.variables["H"].shape == CSI.shape
    np.testing.assert_array_equal(capture.read("H"), CSI)
    np.testing.assert_array_equal(capture.read("xyz"), POSITION)


@pytest.mark.parametrize("kind", KINDS)
def test_a_variable_that_is_not_there(capture_file: Make, kind: str) -> None:
    capture = open_capture(capture_file(kind))
    with pytest.raises(SetupError, match=r'no variable "h"; it has H: .*\(4, 3, 2\), xyz: .*\(4, 3\)'):
        capture.read("h")


def test_one_array_alone(tmp_path: Path) -> None:
    path = tmp_path / "capture.dat"
    with path.open("wb") as file:
        np.save(file, CSI)
    capture = open_capture(path)
    assert capture.listing() == "array: complex64 (4, 3, 2)"
    np.testing.assert_array_equal(capture.read("array"), CSI)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(SetupError, match="holds 191 bytes"):
        open_capture(path)


def test_no_format_fits(tmp_path: Path) -> None:
    path = tmp_path / "capture.npz"
    path.write_bytes(b"nothing of the kind" * 20)
    with pytest.raises(SetupError, match="no format that can be imported") as caught:
        open_capture(path)
    for words in (
        "not NumPy .npz: it is no zip archive",
        "not NumPy .npy: it has no NumPy header",
        "not MATLAB v5 .mat: it has no MATLAB header",
        "not HDF5 or MATLAB v7.3 .mat: it has no HDF5 signature",
        "not TFRecord: its first record's length has another checksum",
    ):
        assert words in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"nowhere\.npz cannot be read: No such file"):
        open_capture(tmp_path / "nowhere.npz")


def test_pickled_objects_are_never_read(tmp_path: Path) -> None:
    path = tmp_path / "objects.npz"
    np.savez(path, H=np.array([{"a": 1}, None], object))
    capture = open_capture(path)
    with pytest.raises(SetupError, match="Object arrays cannot be loaded"):
        capture.read("H")


def test_files_without_variables(tmp_path: Path) -> None:
    np.savez(tmp_path / "empty.npz")
    with pytest.raises(SetupError, match="without NumPy arrays"):
        open_capture(tmp_path / "empty.npz")
    h5py.File(tmp_path / "empty.h5", "w").close()
    with pytest.raises(SetupError, match="without datasets"):
        open_capture(tmp_path / "empty.h5")


def test_a_header_that_promises_more_than_the_file_has_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "large.npz"
    np.savez(path, H=np.zeros(100_000, np.complex64))
    path.write_bytes(path.read_bytes().replace(b"(100000,)", b"(999999,)"))
    with pytest.raises(SetupError, match=r"large\.npz.*holds 800000 bytes"):
        open_capture(path)
    path = tmp_path / "sparse.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("H", (10**6, 10**6), np.complex64, chunks=(100, 100))
    with pytest.raises(SetupError, match="claims 8000000000000 bytes"):
        open_capture(path)


def test_datasets_in_groups_and_links_that_lead_nowhere(tmp_path: Path) -> None:
    path = tmp_path / "groups.h5"
    with h5py.File(path, "w") as file:
        file["run/1/csi"] = CSI
        file["run/loop"] = h5py.SoftLink("/run")
        file["away"] = h5py.ExternalLink("/etc/passwd", "/")
    capture = open_capture(path)
    assert set(capture.variables) == {"run/1/csi"}
    np.testing.assert_array_equal(capture.read("run/1/csi"), CSI)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_cut_and_damaged_files_give_an_error_or_the_data(
    tmp_path: Path, capture_file: Make, kind: str, data: st.DataObject
) -> None:
    whole = capture_file(kind).read_bytes()
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)), "length")])
    for _ in range(data.draw(st.integers(0, 3), "flips") if damaged else 0):
        damaged[data.draw(st.integers(0, len(damaged) - 1), "at")] ^= data.draw(st.integers(1, 255), "by")
    path = tmp_path / "damaged"
    path.write_bytes(damaged)
    try:
        capture = open_capture(path)
        for name in capture.variables:
            assert isinstance(capture.read(name), np.ndarray)
    except SetupError as error:
        event(str(error).partition(":")[0])
