from __future__ import annotations

import numpy as np
import pytest
from chart_samples import some_chart
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.data import extras
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError


def test_columns_of_other_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match=r"rho must have shape \(5,\), not \(4,\)"):
        some_chart(5).with_columns(rho=np.zeros(4))
    with pytest.raises(ValueError, match=r"position must have shape \(5, 3\)"):
        some_chart(5).with_columns(position=np.zeros((5, 2), np.float32))


def test_columns_are_those_of_the_schema() -> None:
    chart = some_chart(5)
    with pytest.raises(ValueError, match="no column 'heigth', only ue, time_ns, theta"):
        chart.with_columns(heigth=np.zeros(5))
    with pytest.raises(ValueError, match="needs theta, y"):
        ChartUpdate(
            "lab",
            chart.method,
            chart.ue,
            chart.time_ns,
            rho=chart.rho,
            x=chart.x,
            snr=chart.snr,
            snapshots=chart.snr,
        )
    with pytest.raises(AttributeError, match="no 'heigth'"):
        print(chart.heigth)  # type: ignore[attr-defined]


def test_it_says_what_it_is_in_a_line() -> None:
    expected = "<ChartUpdate of 'lab' by bartlett/isq: 5 UEs, theta_std, rho_std, position>"
    assert repr(some_chart(5)) == expected


def test_to_pandas() -> None:
    pytest.importorskip("pandas")
    chart = some_chart(6)
    frame = chart.to_pandas()
    assert list(frame)[:4] == ["ue", "time_ns", "theta", "rho"]
    assert list(frame)[-3:] == ["position_x", "position_y", "position_z"]
    np.testing.assert_array_equal(frame["rho"], chart.rho)
    assert frame.attrs == {"array": "lab", "theta": "bartlett", "rho": "isq"}


def test_without_pandas_the_way_to_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    with pytest.raises(SetupError, match=r'pip install "chachart\[pandas\]"'):
        some_chart(3).to_pandas()


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(1, 6), st.booleans()), min_size=1, max_size=5))
def test_concatenate_keeps_the_newest_row_of_each_ue(parts: list[tuple[int, int, bool]]) -> None:
    charts = [
        some_chart(n, first_ue=first, seed=i, position=position)
        for i, (first, n, position) in enumerate(parts)
    ]
    newest = {int(ue): (i, row) for i, c in enumerate(charts) for row, ue in enumerate(c.ue)}
    whole = ChartUpdate.concatenate(charts)
    assert sorted(whole.ue.tolist()) == sorted(newest)
    for row, ue in enumerate(whole.ue.tolist()):
        part, theirs = newest[ue]
        assert whole.rho[row] == charts[part].rho[theirs]
        assert whole.time_ns[row] == charts[part].time_ns[theirs]
        known = charts[part].position
        if whole.position is not None:
            expected = np.full(3, np.nan, np.float32) if known is None else known[theirs]
            np.testing.assert_array_equal(whole.position[row], expected)
    assert (whole.position is None) == all(c.position is None for c in charts)


def test_rows_stay_in_order() -> None:
    whole = ChartUpdate.concatenate([some_chart(3), some_chart(2, first_ue=10), some_chart(1, first_ue=1)])
    assert whole.ue.tolist() == [0, 2, 10, 11, 1]


def test_take() -> None:
    chart = some_chart(5)
    taken = chart.take(chart.ue > 2)
    assert taken.ue.tolist() == [3, 4]
    assert taken.position is not None
    assert len(taken) == 2


@pytest.mark.parametrize(("ues", "sizes"), [(0, []), (3, [3]), (4, [4]), (10, [4, 4, 2])])
def test_parts(ues: int, sizes: list[int]) -> None:
    chart = some_chart(ues)
    parts = list(chart.parts(4))
    assert [len(part) for part in parts] == sizes
    assert [ue for part in parts for ue in part.ue.tolist()] == list(range(ues))
