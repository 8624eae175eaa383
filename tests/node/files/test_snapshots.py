from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from chachart.node.files.snapshots import SnapshotError, read_facts, read_snapshot, write_snapshot

FACTS = {"seq": 7, "method": ["music", "isq"]}
ARRAYS = {
    "rows[]": np.arange(12, dtype=np.complex64).reshape(3, 4),
    "ue[]": np.array([2**64 - 1, 0], np.uint64),
    "none": np.zeros((0, 3), np.float32),
    "number": np.array(4.5),
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("snapshots") / "good.snapshot"
    write_snapshot(path, FACTS, ARRAYS.items(), durable=True)
    return path


def test_what_was_written_is_read(good: Path) -> None:
    facts, arrays = read_snapshot(good)
    assert facts == read_facts(good) == FACTS
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)
    assert list(good.parent.iterdir()) == [good]


def test_cut_at_any_byte_it_is_noticed(good: Path, tmp_path: Path) -> None:
    whole, cut = good.read_bytes(), tmp_path / "cut"
    for length in range(len(whole)):
        cut.write_bytes(whole[:length])
        with pytest.raises(SnapshotError, match="damaged"):
            read_snapshot(cut)


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_flipped_byte_is_noticed_or_changes_nothing(
    good: Path, tmp_path: Path, data: st.DataObject
) -> None:
    whole, flipped = bytearray(good.read_bytes()), tmp_path / "flipped"
    at = data.draw(st.integers(0, len(whole) - 1))
    whole[at] ^= data.draw(st.integers(1, 255))
    flipped.write_bytes(whole)
    try:
        facts, arrays = read_snapshot(flipped)
    except SnapshotError:
        return
    assert facts == FACTS
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array)


def test_a_failed_write_leaves_what_was_there(good: Path, tmp_path: Path) -> None:
    path = tmp_path / "state"
    write_snapshot(path, FACTS, ARRAYS.items(), durable=False)

    def broken():  # type: ignore[no-untyped-def]
        yield "rows", np.zeros(3)
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        write_snapshot(path, {}, broken(), durable=False)
    assert read_facts(path) == FACTS
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(SnapshotError):
        read_snapshot(tmp_path / "nothing")


def test_one_that_is_not_wanted_any_more_does_not_appear(tmp_path: Path) -> None:
    path = tmp_path / "state"
    write_snapshot(path, {"n": 1}, (), durable=False)
    write_snapshot(path, {"n": 2}, (), durable=False, wanted=lambda: False)
    assert read_facts(path) == {"n": 1}
    assert list(tmp_path.iterdir()) == [path]
