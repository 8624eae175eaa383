"""Several arrays from an archive to figures: import, the recording, evaluate with fusion and tracking."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from raytraced_archives import write_archive

from chachart.node.commands.main import main
from chachart.node.files.recording import RecordingReader


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two UEs that walk between three boards, in line of sight."""
    return write_archive(tmp_path_factory.mktemp("raytraced") / "walk.npz")


@pytest.fixture(scope="module")
def recording(archive: Path) -> Path:
    path = archive.with_suffix(".mcap")
    assert main(["import", str(archive), str(path), "--snr-db", "10", "--seed", "1"]) == 0
    return path


def test_the_recording_has_all_arrays_in_step(recording: Path) -> None:
    reader = RecordingReader(recording)
    assert [array.name for array in reader.arrays] == ["A", "B", "C"]
    assert not any(array.is_line for array in reader.arrays)
    np.testing.assert_allclose(reader.arrays[0].height_m, 1.5)
    blocks = list(reader.blocks())
    assert [block.array for block in blocks[:4]] == ["A", "B", "C", "A"]
    assert {len(block) for block in blocks} == {2}
    starts = [block.time_ns.min() for block in blocks]
    assert starts == sorted(starts)
    summary = reader.summary()
    assert (summary.frames, summary.ues) == (2 * 30 * 3, 2)


def test_positions_are_fused(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = tmp_path / "fused.json"
    assert main(["evaluate", str(recording), "--json", str(report)]) == 0
    figures = json.loads(report.read_text())
    assert (figures["positions"], figures["clock"]) == (60, "shared")
    assert figures["heard"] == {"A": 60, "B": 60, "C": 60}
    assert figures["error_m"] < 0.1
    assert figures["outliers"] == 0
    assert "60 positions" in capsys.readouterr().out


def test_tracks_are_smoothed(recording: Path, tmp_path: Path) -> None:
    errors = []
    for extra in ((), ("--smooth",)):
        report = tmp_path / "tracked.json"
        command = ["evaluate", str(recording), "--set", "tracking.motion=walk", "--json", str(report), *extra]
        assert main(command) == 0
        errors.append(json.loads(report.read_text())["error_mean_m"])
    assert errors[1] < errors[0] < 0.1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--smooth"], "tracking.motion"),
        (["--set", "fusion.clock=sundial"], "fusion.clock"),
        (["--set", "fusion.area_m=[5, 5, 1, 1]"], "a lower and a higher corner"),
        (["--set", "tracking.motion=walk", "tracking.lag=3", "--smooth"], "exclude each other"),
    ],
)
def test_mistakes_are_told(
    recording: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", str(recording), *options]) != 0
    assert words in capsys.readouterr().err


def test_archives_that_do_not_go_together_are_refused(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(archive) as whole:
        values = {name: whole[name] for name in whole.files}
    values["freqs"] = values["freqs"][:-1]
    np.savez(tmp_path / "short.npz", **values)
    assert main(["import", str(tmp_path / "short.npz"), str(tmp_path / "out.mcap")]) != 0
    assert "freqs must be 32 even frequencies" in capsys.readouterr().err
    assert not (tmp_path / "out.mcap").exists()


def test_refined_positions_are_told_beside_the_others(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "refined.json"
    assert main(["evaluate", str(recording), "--refine", "--json", str(report)]) == 0
    figures = json.loads(report.read_text())
    assert figures["error_m"] < 0.1
    assert figures["refined"]["positions"] == 60
    assert figures["refined"]["error_m"] < 0.1
    assert "refined   " in capsys.readouterr().out
    assert main(["evaluate", str(recording), "--refine", "--set", "tracking.motion=walk"]) != 0
    assert "tracking.motion=off" in capsys.readouterr().err
