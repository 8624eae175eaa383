from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from chachart.node.commands.benchmarks import arrays
from chachart.node.data.errors import SetupError


def test_it_measures_every_array(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(arrays, "SNRS_DB", (10.0,))
    kept = {name: arrays.SHAPES[name] for name in ("board 2 x 4", "circle of 5")}
    monkeypatch.setattr(arrays, "SHAPES", kept)
    parser = argparse.ArgumentParser()
    arrays.add_arguments(parser)
    wanted = parser.parse_args(["--ues", "16", "--frames", "2", "--runs", "1"])
    speed, errors = arrays.run(wanted)
    assert [row[0] for row in speed.rows] == [row[0] for row in errors.rows] == [*arrays.SHAPES]
    assert all(cell is not None for table in (speed, errors) for row in table.rows for cell in row)
    (tmp_path / "no.npz").write_bytes(b"")
    wanted.raytraced = tmp_path / "no.npz"
    with pytest.raises(SetupError, match="does not hold ray-traced channels"):
        arrays.run(wanted)
