from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from chachart.node.errors import SetupError
from chachart.sources.formats import open_capture

CSI = (np.arange(24) + 1j).astype(np.complex64).reshape(4, 3, 2)
POSITION = np.arange(12, dtype=np.float32).reshape(4, 3)


def write(path: Path, kind: str) -> Path:
    if kind == "npz":
        np.savez(path, H=CSI, xyz=POSITION)
    elif kind == "npz_compressed":
        np.savez_compressed(path, H=CSI, xyz=POSITION)
    else:
        savemat(path, {"H": CSI, "xyz": POSITION}, do_compression=kind == "matlab_compressed")
    written = path if path.exists() else path.with_name(f"{path.name}.{kind[:3]}")
    # The name must not matter.
    return written.rename(path.with_suffix(".dat"))


KINDS = ["npz", "npz_compressed", "matlab", "matlab_compressed"]


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gives_back_what_was_written(tmp_path: Path, kind: str) -> None:
    capture = open_capture(write(tmp_path / "capture", kind))
    assert capture.variables["H"].shape == CSI.shape
    np.testing.assert_array_equal(capture.read("H"), CSI)
    np.testing.assert_array_equal(capture.read("xyz"), POSITION)


@pytest.mark.parametrize("kind", KINDS)
def test_a_variable_that_is_not_there(tmp_path: Path, kind: str) -> None:
    capture = open_capture(write(tmp_path / "capture", kind))
    with pytest.raises(SetupError, match=r'no variable "h"; it has H: .*\(4, 3, 2\), xyz: .*\(4, 3\)'):
        capture.read("h")


def test_no_format_fits(tmp_path: Path) -> None:
    path = tmp_path / "capture.npz"
    path.write_bytes(b"nothing of the kind" * 20)
    with pytest.raises(SetupError, match="no format that can be imported") as caught:
        open_capture(path)
    assert "not NumPy .npz: it is no zip archive" in str(caught.value)
    assert "not MATLAB v5 .mat" in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"nowhere\.npz cannot be read: No such file"):
        open_capture(tmp_path / "nowhere.npz")


def test_pickled_objects_are_never_read(tmp_path: Path) -> None:
    path = tmp_path / "objects.npz"
    np.savez(path, H=np.array([{"a": 1}, None], object))
    capture = open_capture(path)
    with pytest.raises(SetupError, match="Object arrays cannot be loaded"):
        capture.read("H")


def test_an_archive_without_arrays(tmp_path: Path) -> None:
    np.savez(tmp_path / "empty.npz")
    with pytest.raises(SetupError, match="without NumPy arrays"):
        open_capture(tmp_path / "empty.npz")


def test_a_header_that_promises_more_than_the_file_has_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "large.npz"
    np.savez(path, H=np.zeros(100_000, np.complex64))
    claims = path.read_bytes().replace(b"(100000,)", b"(999999,)")
    path.write_bytes(claims)
    with pytest.raises(SetupError, match=r"large\.npz.*holds 800000 bytes"):
        open_capture(path).read("H")


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_cut_and_damaged_files_give_an_error_or_the_data(
    tmp_path: Path, kind: str, data: st.DataObject
) -> None:
    folder = tmp_path / "whole"
    folder.mkdir(exist_ok=True)
    whole = write(folder / "capture", kind).read_bytes()
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
