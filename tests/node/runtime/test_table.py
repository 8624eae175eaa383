from __future__ import annotations

import numpy as np
import pytest

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS
from chachart.node.runtime.messages import pack_update, unpack_update
from chachart.node.runtime.table import ChartTable


def update(ue: list[int], time_ns: int = 0, x: float = 0.0, known: bool = False) -> ChartUpdate:
    k = len(ue)
    floats = [column for column in COLUMNS.values() if column.dtype == "float64"]
    position = np.full((k, 3), x, np.float32) if known else None
    return ChartUpdate(
        "lab",
        Method("bartlett", "music"),
        np.array(ue, np.uint64),
        np.full(k, time_ns),
        **{column.name: np.full(column.shape(k), x) for column in floats},
        position=position,
    )


def test_an_empty_table_has_no_chart() -> None:
    table = ChartTable(4)
    assert table.chart() is None
    assert len(table) == 0


def test_the_newest_row_of_each_ue_stays() -> None:
    table = ChartTable(10)
    table.update(update([1, 2], 1, 1.0))
    table.update(update([2, 3], 2, 2.0))
    chart = table.chart()
    assert chart is not None
    assert dict(zip(chart.ue.tolist(), chart.x.tolist(), strict=True)) == {1: 1.0, 2: 2.0, 3: 2.0}
    assert chart.time_ns.tolist() == [1, 2, 2]
    assert chart.position is None
    assert chart.method == Method("bartlett", "music")


def test_a_position_is_known_as_long_as_rows_tell_it() -> None:
    table = ChartTable(10)
    table.update(update([1], 1, 5.0, known=True))
    table.update(update([1, 2], 2, 6.0))
    chart = table.chart()
    assert chart is not None
    assert chart.position is None
    table.update(update([2], 3, 7.0, known=True))
    chart = table.chart()
    assert chart is not None
    np.testing.assert_array_equal(chart["position"], [[np.nan] * 3, [7.0] * 3])


def test_the_oldest_makes_room_and_is_counted() -> None:
    table = ChartTable(3)
    for n in range(5):
        table.update(update([n], n, known=n == 0))
    chart = table.chart()
    assert chart is not None
    assert sorted(chart.ue.tolist()) == [2, 3, 4]
    assert table.evicted == 2
    assert chart.position is None


def test_more_rows_than_room() -> None:
    table = ChartTable(3)
    table.update(update(list(range(10))))
    chart = table.chart()
    assert chart is not None
    assert sorted(chart.ue.tolist()) == [7, 8, 9]


def test_unseen_ues_are_forgotten() -> None:
    table = ChartTable(100)
    table.update(update(list(range(70)), 100))
    table.update(update([3, 4], 200))
    table.forget(150)
    chart = table.chart()
    assert chart is not None
    assert sorted(chart.ue.tolist()) == [3, 4]
    assert table.forgotten == 68


@pytest.mark.parametrize("known", [True, False])
def test_updates_survive_the_way_between_processes(known: bool) -> None:
    before = update([1, 2**64 - 1], 2**62, 1.5, known)
    after = unpack_update(pack_update(before))
    assert (after.array, after.method) == (before.array, before.method)
    for name in ("ue", "time_ns", "theta", "rho", "theta_std", "rho_std", "x", "y", "snr", "snapshots"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert (after.position is None) == (before.position is None)
    if before.position is not None:
        np.testing.assert_array_equal(after.position, before.position)
