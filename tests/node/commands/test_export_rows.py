from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chart_logs import near_truth, plotted_array, write_chart_log, write_recording
from chart_samples import some_chart
from csi_samples import small_array
from pyarrow import parquet

from chachart.node.commands.exporting.rows import Place, Table
from chachart.node.commands.main import main
from chachart.node.data.errors import SetupError

HERE = ["--latitude", "48.0", "--longitude", "11.5", "--heading-deg", "90"]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Ten UEs, then four of them again in other places."""
    return write_chart_log(tmp_path / "log.mcap", near_truth(10), near_truth(4, seed=1))


def test_csv(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(log), str(tmp_path / "a.csv")]) == 0
    assert "14 rows" in capsys.readouterr().out
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    chart = near_truth(10)
    assert [int(row["ue"]) for row in rows] == [*range(10), *range(4)]
    assert [int(row["time_ns"]) for row in rows[:10]] == chart.time_ns.tolist()
    np.testing.assert_allclose([float(row["x_m"]) for row in rows[:10]], chart.x, atol=1e-3)
    assert chart.position is not None
    np.testing.assert_allclose([float(r["position_y_m"]) for r in rows[:10]], chart.position[:, 1], atol=1e-3)
    assert {row["theta_std_rad"] for row in rows} == {""}
    assert {(row["theta_method"], row["rho_method"]) for row in rows} == {("music", "bartlett")}


def test_parquet(log: Path, tmp_path: Path) -> None:
    assert main(["export", str(log), str(tmp_path / "a.parquet")]) == 0
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.num_rows == 14
    assert str(table.schema.field("ue").type) == "uint64"
    assert str(table.schema.field("time_ns").type) == "int64"
    np.testing.assert_allclose(table["rho_m"].to_numpy()[:10], near_truth(10).rho, atol=1e-3)
    assert table["theta_std_rad"].null_count == 14
    about = json.loads(table.schema.metadata[b"chachart.array"])
    assert about["antennas"] == plotted_array().antennas


def test_newest_rows_of_a_stretch(log: Path, tmp_path: Path) -> None:
    argv = ["export", str(log), str(tmp_path / "a.csv"), "--newest", "--from", "0.02", "--to", "0.05"]
    assert main(argv) == 0
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sorted(int(row["ue"]) for row in rows) == [2, 3, 4]
    again = near_truth(4, seed=1)
    where = {int(row["ue"]): float(row["x_m"]) for row in rows}
    assert where[2] == pytest.approx(again.x[2], abs=1e-3)


def test_geojson_turns_the_chart_to_its_heading(log: Path, tmp_path: Path) -> None:
    """Looking east, x is east and y, to the left, north."""
    assert main(["export", str(log), str(tmp_path / "a.geojson"), *HERE]) == 0
    document = json.loads((tmp_path / "a.geojson").read_text())
    assert document["type"] == "FeatureCollection"
    assert len(document["features"]) == 14
    chart = near_truth(10)
    points = np.array([f["geometry"]["coordinates"] for f in document["features"][:10]])
    metres_a_degree = np.array([74_632.0, 111_200.0])  # at 48 degrees
    offset = (points - [11.5, 48.0]) * metres_a_degree
    np.testing.assert_allclose(offset, np.stack([chart.x, chart.y], axis=1), rtol=1e-2, atol=1)
    first = document["features"][0]["properties"]
    assert first["time"] == "2023-11-14T22:13:20.000000+00:00"
    assert (first["ue"], first["array"], first["theta_std_rad"]) == (0, "lab", None)


def test_an_array_seen_from_its_other_side_is_not_mirrored() -> None:
    """y runs along the axis: to the right of broadside if the axis does."""
    chart, array = near_truth(5), plotted_array()
    place = Place(10.0, 20.0, 0.0)
    left = place.coordinates(chart, array)
    right = place.coordinates(chart, replace(array, axis=(0.0, -1.0, 0.0)))
    np.testing.assert_allclose(left[:, 0] - 20, 20 - right[:, 0])
    np.testing.assert_allclose(left[:, 1], right[:, 1])
    with pytest.raises(SetupError, match="no map"):
        place.coordinates(chart, replace(array, axis=(0.0, 0.0, 1.0)))


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["log.mcap", "a.npz"], "must end in one of .csv, .parquet, .geojson; log.mcap is a chart log"),
        (["r.mcap", "a.csv"], "must end in one of .npz, .h5, .hdf5, .mat"),
        (["log.mcap", "a.geojson"], "needs the array's place"),
        (["log.mcap", "a.geojson", *HERE[:3], "999", *HERE[4:]], "no place at latitude 48.0, longitude 999"),
        (["log.mcap", "a.csv", "--from", "9"], "has no rows in that time"),
        (["log.mcap", "a.parquet", "--from", "9"], "has no rows in that time"),
    ],
)
def test_what_cannot_be(
    log: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    argv: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(log.parent)
    write_recording(Path("r.mcap"), ues=4, frames=4)
    assert main(["export", *argv]) == 78
    said = capsys.readouterr().err
    assert words in said
    assert len(said.splitlines()) == 1
    assert sorted(p.name for p in log.parent.iterdir()) == ["log.mcap", "r.mcap"]


@pytest.mark.parametrize("name", ["=cmd", "+1", "-lab", "@sum", "lab"])
def test_no_cell_is_a_formula(name: str) -> None:
    chart = some_chart(2, array=name)
    table = Table(("ue",), small_array())
    [first, _] = table.rows(chart)
    assert first[1] == (name if name == "lab" else f"'{name}")
