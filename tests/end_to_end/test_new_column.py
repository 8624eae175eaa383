"""A column that is added to the schema goes everywhere, with nothing else changed."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from chart_logs import near_truth, plotted_array, write_chart_log
from pyarrow import parquet

from chachart.node.commands import ctl
from chachart.node.commands.main import main
from chachart.node.commands.watch import json_line
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.columns import COLUMNS, Column, markdown
from chachart.node.files.chart_log import ChartLogReader
from chachart.node.net.wire import decode_chart, encode_chart
from chachart.node.runtime.messages import pack_update, unpack_update
from chachart.node.runtime.requests import chart_columns, ue_list
from chachart.node.runtime.table import ChartTable
from chachart.sinks.plain import plain
from chachart.sinks.view.frames import describe, encode_frame

NEW = (
    Column("tilt", "float64", "tilt", "How far it leans.", "rad", 4, optional=True),
    Column("hops", "uint8", "hops", "How many reflections.", decimals=0, optional=True),
    Column("drift", "float32", "drift", "Where it goes.", "m/s", 2, optional=True, parts=("x", "y")),
)
FLAT = ["tilt", "hops", "drift_x", "drift_y"]
FILES = ["tilt_rad", "hops", "drift_x_m_s", "drift_y_m_s"]


@pytest.fixture(autouse=True)
def wider_schema(monkeypatch: pytest.MonkeyPatch) -> None:
    for column in NEW:
        monkeypatch.setitem(COLUMNS, column.name, column)


@pytest.fixture
def chart() -> ChartUpdate:
    """Eight UEs, of one of which nothing new is known."""
    rows = np.arange(8)
    tilt = rows / 16
    tilt[7] = np.nan
    drift = np.stack([rows / 4, -rows / 4], axis=1).astype(np.float32)
    return near_truth(8).with_columns(tilt=tilt, hops=rows.astype(np.uint8), drift=drift)


@pytest.fixture
def log(tmp_path: Path, chart: ChartUpdate) -> Path:
    """First rows without the new columns, then with them."""
    return write_chart_log(tmp_path / "log.mcap", near_truth(4, seed=1), chart)


def assert_carried(carried: ChartUpdate | None, chart: ChartUpdate) -> None:
    assert carried is not None
    for column in NEW:
        np.testing.assert_array_equal(carried[column.name], chart[column.name])
        assert carried[column.name].dtype == column.dtype


def test_between_processes(chart: ChartUpdate) -> None:
    assert_carried(unpack_update(pack_update(chart)), chart)


def test_on_the_wire(chart: ChartUpdate, monkeypatch: pytest.MonkeyPatch) -> None:
    message = encode_chart(chart, 3)
    assert_carried(decode_chart(message)[1], chart)
    for column in NEW:
        monkeypatch.delitem(COLUMNS, column.name)
    older = decode_chart(message)[1]
    assert list(older.columns) == list(near_truth(1).columns), "what a receiver does not know it leaves out"


def test_what_is_missing_is_filled_in(chart: ChartUpdate) -> None:
    old = decode_chart(encode_chart(near_truth(3), 0))[1]
    assert "tilt" not in old.columns
    assert np.isnan(old["tilt"]).all()
    assert old["hops"].tolist() == [0, 0, 0]
    both = ChartUpdate.concatenate([chart, old])
    assert np.isnan(both["tilt"][-3:]).all()
    assert both["hops"].tolist() == [3, 4, 5, 6, 7, 0, 0, 0]


def test_in_the_table(chart: ChartUpdate) -> None:
    table = ChartTable(20)
    table.update(near_truth(2))
    table.update(chart)
    assert_carried(table.chart(), chart)
    table.update(near_truth(8))
    after = table.chart()
    assert after is not None
    assert not {"tilt", "hops", "drift"} & set(after.columns), "a row never keeps what a newer one lacks"


def test_in_answers_to_requests(chart: ChartUpdate) -> None:
    assert [ue["hops"] for ue in ue_list(chart)["ues"]] == chart["hops"].tolist()
    np.testing.assert_array_equal(chart_columns(chart, plotted_array())["drift"], chart["drift"])


def test_in_chart_logs(log: Path, chart: ChartUpdate) -> None:
    assert_carried(ChartLogReader(log).chart(), chart)


def test_in_frames_of_the_page(chart: ChartUpdate) -> None:
    frame = encode_frame(chart, plotted_array(), full=True)
    length = int.from_bytes(frame[:4], "little")
    kinds = dict(json.loads(frame[4 : 4 + length])["columns"])
    assert [kinds[name] for name in FLAT] == ["f4", "u4", "f4", "f4"]
    told = {column["name"]: column for column in describe()}
    assert [told[name]["file_name"] for name in FLAT] == FILES


def test_in_exported_files(log: Path, tmp_path: Path, chart: ChartUpdate) -> None:
    for name in ("a.csv", "a.parquet"):
        assert main(["export", str(log), str(tmp_path / name)]) == 0
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["tilt_rad"] for row in rows[:4]] == [""] * 4
    assert [float(row["tilt_rad"]) for row in rows[4:11]] == np.round(chart["tilt"][:7], 4).tolist()
    assert [int(row["hops"]) for row in rows[4:]] == list(range(8))
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table["drift_y_m_s"].to_pylist()[4:] == chart["drift"][:, 1].tolist()
    where = ["--newest", "--latitude", "48", "--longitude", "11", "--heading-deg", "90"]
    assert main(["export", str(log), str(tmp_path / "a.geojson"), *where]) == 0
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert [feature["properties"]["hops"] for feature in features] == list(range(8))


def test_in_ctl(chart: ChartUpdate, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ctl.show_ues({"ues": ue_list(chart)["ues"]})
    heading, *rows = capsys.readouterr().out.splitlines()
    assert "tilt °" in heading
    assert "drift m/s" in heading
    assert len(rows) == 8
    answer = plain(chart_columns(chart, plotted_array()))
    ctl.save_chart(answer, tmp_path / "chart.csv")
    with (tmp_path / "chart.csv").open(newline="") as file:
        assert [int(row["hops"]) for row in csv.DictReader(file)] == list(range(8))


def test_in_the_documentation() -> None:
    assert "| `tilt` | float64 | rad | How far it leans. May be missing. |" in markdown()


def test_in_data_frames(chart: ChartUpdate) -> None:
    assert list(chart.to_pandas())[-4:] == FLAT


def test_in_what_watch_prints(chart: ChartUpdate) -> None:
    assert json.loads(json_line(chart, 0))["hops"] == chart["hops"].tolist()
