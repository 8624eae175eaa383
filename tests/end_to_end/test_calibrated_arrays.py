"""A node whose arrays are elsewhere, and later, than they are described, with and without a calibration."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from misplaced_arrays import hall, write_recording
from node_runs import DEADLINE_S, until

from chachart.config.load import settings_of
from chachart.node.commands.main import main
from chachart.node.data.errors import SetupError
from chachart.node.files.recording import RecordingReader
from chachart.node.runtime.node import Node
from chachart.node.runtime.plan import Plan

UES = 60
AREA = ("fusion.area_m=[-10, -10, 10, 10]", "fusion.height_m=free")


def _plan(recording: Path, *changes: str) -> Plan:
    document: dict[str, Any] = {
        "source": {"type": "recording", "path": str(recording), "speed": 0.2},
        "sinks": [{"type": "recorder", "path": str(recording.with_name("again-{time}.mcap"))}],
    }
    return Plan.of(settings_of(document, [*AREA, *changes], "test"))


def _error(recording: Path, *changes: str) -> float:
    """Median error of what is fused of a recording."""
    report = recording.with_suffix(".json")
    told = [f"--set={change}" for change in (*AREA, *changes)]
    assert main(["evaluate", str(recording), "--json", str(report), *told]) == 0
    return float(json.loads(report.read_text())["error_m"])


def test_a_calibration_puts_arrays_right_and_is_told(tmp_path: Path) -> None:
    there = hall(7)
    write_recording(tmp_path / "known.mcap", there, 7, echoes=0.1)
    write_recording(tmp_path / "new.mcap", there, 8, echoes=0.1)
    output = tmp_path / "arrays.toml"
    assert main(["calibrate", str(tmp_path / "known.mcap"), "--arrays", "-o", str(output)]) == 0
    node = Node(_plan(tmp_path / "new.mcap", f"fusion.calibration={output}"))
    node.start()

    def told() -> bool:
        chart, arrays = node.chart(), node.status()["arrays"]
        drifts = any(one["drift_ns"] is not None for one in arrays)
        return chart is not None and len(chart) == UES and drifts

    try:
        until(told, "all UEs are on the chart, and arrays are told of")
        chart, arrays = node.chart(), {one["name"]: one for one in node.status()["arrays"]}
    finally:
        node.stop(0.1)
        assert node.wait(DEADLINE_S)
        node.close()
    assert chart is not None
    off = np.hypot(chart.x - chart["position"][:, 0], chart.y - chart["position"][:, 1])
    assert np.median(off) < 0.3
    for array, late_s in zip(there.right, there.late_s, strict=True):
        one = arrays[array.name]
        assert one["offset_ns"] == pytest.approx(1e9 * late_s, abs=2.0)
        assert one["offset_std_ns"] is None or 0 < one["offset_std_ns"] < 2.0
        assert one["drift_ns"] is None or abs(one["drift_ns"]) < 2.0
    (again,) = tmp_path.glob("again-*")
    kept = RecordingReader(again).array  # as received, by arrays as described
    assert kept.position_m == pytest.approx(there.described[0].position_m)
    assert kept.calibration is None
    assert _error(again) > 1.0
    assert _error(again, f"fusion.calibration={output}") < 0.3


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
