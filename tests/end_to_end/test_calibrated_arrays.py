"""A node whose arrays are elsewhere, and later, than they are described, with and without a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from misplaced_arrays import hall, write_recording
from node_runs import DEADLINE_S

from chachart.config.load import settings_of
from chachart.node.commands.main import main
from chachart.node.data.errors import SetupError
from chachart.node.files.recording import RecordingReader
from chachart.node.runtime.node import Node
from chachart.node.runtime.plan import Plan


def _plan(recording: Path, *changes: str) -> Plan:
    document: dict[str, Any] = {
        "source": {"type": "recording", "path": str(recording), "speed": 0},
        "fusion": {"area_m": [-10.0, -10.0, 10.0, 10.0], "height_m": "free"},
        "sinks": [{"type": "recorder", "path": str(recording.with_name("again-{time}.mcap"))}],
    }
    return Plan.of(settings_of(document, list(changes), "test"))


def _errors(recording: Path, *changes: str) -> tuple[float, dict[str, Any]]:
    """Median error of the last position of each UE, and the node's summary."""
    node = Node(_plan(recording, *changes))
    node.start()
    assert node.wait(DEADLINE_S)
    chart, status = node.chart(), node.status()
    node.close()
    assert chart is not None
    off = np.hypot(chart.x - chart["position"][:, 0], chart.y - chart["position"][:, 1])
    return float(np.median(off)), {one["name"]: one for one in status["arrays"]}


def test_a_calibration_puts_arrays_right_and_is_told(tmp_path: Path) -> None:
    there = hall(7)
    write_recording(tmp_path / "known.mcap", there, 7)
    write_recording(tmp_path / "new.mcap", there, 8)
    output = tmp_path / "arrays.toml"
    assert main(["calibrate", str(tmp_path / "known.mcap"), "--arrays", "-o", str(output)]) == 0
    before, _ = _errors(tmp_path / "new.mcap")
    after, told = _errors(tmp_path / "new.mcap", f"fusion.calibration={output}")
    assert before > 1.0
    assert after < 0.3
    for array, late_s in zip(there.right, there.late_s, strict=True):
        assert told[array.name]["offset_ns"] == pytest.approx(1e9 * late_s, abs=2.0)
        assert 0 < told[array.name]["offset_std_ns"] < 2.0
        assert abs(told[array.name]["drift_ns"]) < 2.0
    again = RecordingReader(sorted(tmp_path.glob("again-*"))[-1])  # as received, by arrays as described
    np.testing.assert_allclose(again.array.position_m, there.described[0].position_m)
    assert again.array.calibration is None
    replayed, _ = _errors(again.path, f"fusion.calibration={output}")
    assert replayed == pytest.approx(after, rel=0.2)


def test_what_does_not_fit_is_told(tmp_path: Path) -> None:
    write_recording(tmp_path / "a.mcap", hall(), 0, ues=6)
    for text, why in (
        ('[[array]]\nname = "north"\noffset_ns = 3.0\n', "there is no array north, only a, b, c"),
        (
            '[[array]]\nname = "a"\nposition_m = [0, 0, 0]\n',
            "must have position_m, axis and broadside, or none",
        ),
        ('[[array]]\nname = "a"\n[[array]]\nname = "a"\n', "array a is there twice"),
        (
            '[[array]]\nname = "a"\nposition_m = [0, 0, 0]\naxis = [1, 0, 0]\nbroadside = [1, 0, 0]\n',
            "must be orthogonal unit vectors",
        ),
        ("array = 3", "is no calibration of arrays"),
    ):
        (tmp_path / "bad.toml").write_text(text)
        try:
            problems = _plan(tmp_path / "a.mcap", f"fusion.calibration={tmp_path / 'bad.toml'}").problems()
        except SetupError as error:
            problems = [str(error)]
        assert any(why in problem for problem in problems), problems
