from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from chart_logs import near_truth, plotted_array, write_chart_log, write_recording
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.files.chart_log import ChartLogReader, is_chart_log


@pytest.mark.parametrize("settings", [{}, {"encoding": "msgpack"}, {"foxglove": True}])
def test_what_was_written_is_read(tmp_path: Path, settings: dict[str, object]) -> None:
    first, second = near_truth(6), near_truth(4, seed=1)
    path = write_chart_log(tmp_path / "a.mcap", first, second, reports=2, **settings)
    reader = ChartLogReader(path)
    assert is_chart_log(path)
    assert reader.array == plotted_array()
    read = list(reader.charts())
    assert [len(update) for update in read] == [6, 4]
    assert read[0].method == first.method
    np.testing.assert_array_equal(read[0].ue, first.ue)
    np.testing.assert_array_equal(read[0].time_ns, first.time_ns)
    np.testing.assert_allclose(read[0].x, first.x, atol=1e-3)
    assert np.isnan(read[0].theta_std).all()
    assert read[0].position is not None
    np.testing.assert_allclose(read[0].position, first.position, atol=1e-3)
    newest, expected = reader.chart(), ChartUpdate.concatenate([first, second])
    assert newest is not None
    np.testing.assert_allclose(newest.y, expected.y, atol=1e-3)
    reports = list(reader.quality())
    assert [report["tw"] for report in reports] == [0.9, 0.95]
    assert reports[0]["time_ns"] <= reports[1]["time_ns"]
    assert reader.damaged.as_dict() == {}


def test_without_positions(tmp_path: Path) -> None:
    [update] = ChartLogReader(write_chart_log(tmp_path / "a.mcap", near_truth(3, position=False))).charts()
    assert update.position is None


def test_what_is_no_chart_log(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no MCAP at all")
    recording = write_recording(tmp_path / "r.mcap", ues=4, frames=4)
    for path in (tmp_path / "text", recording):
        assert not is_chart_log(path)
        with pytest.raises(SetupError, match="is no chart log"):
            ChartLogReader(path)
    assert not is_chart_log(tmp_path / "nothing")
    with pytest.raises(SetupError, match="cannot read"):
        ChartLogReader(tmp_path / "nothing")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    updates = [near_truth(4, seed=n) for n in range(3)]
    return write_chart_log(tmp_path_factory.mktemp("log") / "a.mcap", *updates, reports=2)


@given(cut=st.integers(0, 1 << 20))
def test_cut_off_anywhere(log: Path, cut: int) -> None:
    content = log.read_bytes()
    part = log.with_name("cut.mcap")
    part.write_bytes(content[: cut % len(content)])
    with contextlib.suppress(SetupError):
        reader = ChartLogReader(part)
        assert len(list(reader.charts())) in (0, 3)
        assert reader.damaged.as_dict() in ({}, {"cut_off": 1})


@given(place=st.integers(0, 1 << 20), flip=st.integers(1, 255))
def test_damaged_anywhere(log: Path, place: int, flip: int) -> None:
    content = bytearray(log.read_bytes())
    content[place % len(content)] ^= flip
    part = log.with_name("damaged.mcap")
    part.write_bytes(content)
    with contextlib.suppress(SetupError):
        reader = ChartLogReader(part)
        assert len(list(reader.charts())) <= 3
        list(reader.quality())
