"""A node that plays a recording of several arrays: fused, tracked, and told as it is."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from node_runs import DEADLINE_S
from raytraced_archives import write_archive

from chachart.config.load import settings_of
from chachart.node.commands.main import main
from chachart.node.files.recording import RecordingReader
from chachart.node.runtime.node import Node
from chachart.node.runtime.plan import Plan, check


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    archive = write_archive(tmp_path / "walk.npz")
    path = tmp_path / "walk.mcap"
    assert main(["import", str(archive), str(path), "--snr-db", "10", "--seed", "1"]) == 0
    return path


def _settings(recording: Path, *changes: str) -> Plan:
    document = {
        "source": {"type": "recording", "path": str(recording), "speed": 0},
        "workers": {"count": 2},
    }
    return Plan.of(settings_of(document, ["tracking.motion=walk", *changes], "test"))


def test_a_node_fuses_and_tracks_what_a_recording_of_several_arrays_holds(recording: Path) -> None:
    node = Node(_settings(recording))
    node.start()
    assert node.wait(DEADLINE_S)
    chart = node.chart()
    summary = node.close()
    assert summary["frames_in"] == summary["frames_estimated"] == 2 * 30 * 3
    assert summary["gaps"] == summary["out_of_order"] == 0
    assert chart is not None
    assert (chart.array, len(chart)) == ("fused", 2)
    assert chart["arrays"].tolist() == [3, 3]
    truth = chart["position"]
    np.testing.assert_allclose(np.column_stack([chart.x, chart.y]), truth[:, :2], atol=0.3)
    np.testing.assert_allclose(chart["vx"], 1.3, atol=0.3)


def test_what_does_not_fit_is_told_before_the_start(recording: Path) -> None:
    assert _settings(recording).problems() == []
    lost = _settings(recording, "fusion.outline_m=[[500, 500], [600, 600], [700, 700]]")
    assert any("is empty" in problem for problem in lost.problems())


def test_what_is_recorded_has_all_arrays(recording: Path) -> None:
    again = recording.with_name("again.mcap")
    document = {
        "source": {"type": "recording", "path": str(recording), "speed": 0},
        "sinks": [{"type": "recorder", "path": str(again)}],
    }
    settings = settings_of(document, [], "test")
    assert check(settings) == []
    node = Node(Plan.of(settings))
    node.start()
    assert node.wait(DEADLINE_S)
    node.close()
    before, after = RecordingReader(recording), RecordingReader(again)
    assert after.arrays == before.arrays
    assert _frames(after) == _frames(before)


def _frames(reader: RecordingReader) -> dict[str, int]:
    counts = Counter(block.array for block in reader.blocks() for _ in block.ue)
    return dict(counts)
