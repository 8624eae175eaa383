"""Several arrays from an archive to figures: import, the recording, evaluate with fusion and tracking."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from chachart.node.commands.main import main
from chachart.node.files.recording import RecordingReader

LIGHT = 299_792_458.0
TONES = 32


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two UEs that walk between three boards, in line of sight."""
    steps, tracks = 30, 2
    frequencies = 3.5e9 + (np.arange(TONES) - TONES // 2) * 50e6 / TONES
    half = LIGHT / 3.5e9 / 2
    frames, elements = [], []
    for x, y in ((-15.0, -15.0), (15.0, -15.0), (0.0, 18.0)):
        normal = np.array([-x, -y, 0.0]) / np.hypot(x, y)
        up = np.array([0.0, 0.0, 1.0])
        right = np.cross(up, normal)
        frames.append(np.stack([normal, right, up], axis=1))
        elements.append(
            [[x, y, 3.0] + half * ((c - 1.5) * right + (0.5 - r) * up) for r in (0, 1) for c in range(4)]
        )
    places = np.array(elements)
    time_s = np.tile(np.arange(steps) * 0.1, tracks)
    track = np.repeat(np.arange(tracks), steps)
    position = np.column_stack([-3 + 1.3 * time_s, 4.0 - 6.0 * track, np.full(len(track), 1.5)])
    far = np.linalg.norm(position[:, None, None] - places, axis=-1)
    h = np.exp(-2j * np.pi * far[..., None] * frequencies / LIGHT) / far[..., None]
    scale = np.abs(h).max(axis=(2, 3)) / 500
    scaled = h / scale[:, :, None, None]
    path = tmp_path_factory.mktemp("raytraced") / "walk.npz"
    np.savez(
        path,
        iq=np.round(np.stack([scaled.real, scaled.imag], axis=-1)).astype(np.int16),
        iq_scale=scale.astype(np.float32),
        freqs=frequencies,
        elements=places,
        array_R=np.array(frames),
        position=position,
        track=track.astype(np.int32),
        time=time_s,
        area=np.array([-12.0, 12.0, -12.0, 12.0]),
    )
    return path


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
