"""Finding where several arrays are and how late their clocks, and what a chart is worth with that."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from misplaced_arrays import Hall, hall, write_recording
from scipy.spatial.transform import Rotation

from chachart.node.commands.main import main
from chachart.node.files.placements import load_placements
from chachart.node.files.recording import RecordingReader, RecordingWriter

RAYTRACED = Path(__file__).parents[4] / "shared" / "data" / "raytraced"


def _off(there: Hall, output: Path, first_is_zero: bool = False) -> tuple[list[Any], list[Any]]:
    """Errors of middles (m), turns (rad) and offsets (ns), and these in told deviations."""
    errors, told = [], []
    for place, right, late_s in zip(load_placements(output), there.right, there.late_s, strict=True):
        found = place.posed(right)
        middle = found.centre_m - right.centre_m
        turn = Rotation.from_matrix(right.frame @ found.frame.T).as_rotvec()
        assert place.offset_s is not None
        late = place.offset_s - (late_s - there.late_s[0] * first_is_zero)
        errors.append((np.linalg.norm(middle), np.linalg.norm(turn), abs(1e9 * late)))
        deviations = np.concatenate([place.position_std_m, place.turn_std_rad, [place.offset_std_s]])
        off = np.concatenate([middle, turn, [late]])
        told += (np.abs(off) / np.maximum(deviations, 1e-12)).tolist() if place.offset_s else []
    return errors, told


@pytest.mark.parametrize("own_clocks", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_poses_and_offsets_are_found_within_what_is_told(
    tmp_path: Path, seed: int, own_clocks: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    there, output = hall(seed), tmp_path / "arrays.toml"
    write_recording(tmp_path / "hall.mcap", there, seed, own_clocks)
    assert main(["calibrate", str(tmp_path / "hall.mcap"), "--arrays", "-o", str(output)]) == 0
    errors, told = _off(there, output, first_is_zero=own_clocks)
    for middle_m, turn_rad, late_ns in errors:
        assert middle_m < 0.25
        assert turn_rad < 0.02
        assert late_ns < 0.3
    assert max(told) < 5.0
    assert np.sqrt(np.mean(np.square(told))) < 2.0
    assert "±" in capsys.readouterr().out


def _error(recording: Path, *changes: str) -> dict[str, Any]:
    report = recording.with_suffix(".json")
    assert main(["evaluate", str(recording), "--json", str(report), *(f"--set={c}" for c in changes)]) == 0
    found: dict[str, Any] = json.loads(report.read_text())
    return found


def test_a_fused_chart_that_was_bad_becomes_good(tmp_path: Path) -> None:
    there, output = hall(3), tmp_path / "arrays.toml"
    write_recording(tmp_path / "known.mcap", there, 3)
    write_recording(tmp_path / "new.mcap", there, 4)
    assert main(["calibrate", str(tmp_path / "known.mcap"), "--arrays", "-o", str(output)]) == 0
    where = ["fusion.area_m=[-10,-10,10,10]", "fusion.height_m=free"]
    before = _error(tmp_path / "new.mcap", *where)
    after = _error(tmp_path / "new.mcap", *where, f"fusion.calibration={output}")
    assert before["error_m"] > 1.0
    assert after["error_m"] < 0.15
    exact = replace(there, described=there.right, late_s=(0.0, 0.0, 0.0))
    write_recording(tmp_path / "exact.mcap", exact, 4)
    assert after["error_m"] < 1.5 * _error(tmp_path / "exact.mcap", *where)["error_m"]


def test_places_come_from_a_table(tmp_path: Path) -> None:
    there = hall(5)
    places = write_recording(tmp_path / "a.mcap", there, 5, positions=False)
    lines = [f"{ue},{x},{y},{z}" for ue, (x, y, z) in enumerate(places)]
    (tmp_path / "places.csv").write_text("\n".join(["ue,x,y,z", *lines]) + "\n")
    words = ["calibrate", str(tmp_path / "a.mcap"), "--arrays", "-o", str(tmp_path / "a.toml")]
    assert main(words) == 78
    report = ["--json", str(tmp_path / "a.json")]
    assert main([*words, "--places", str(tmp_path / "places.csv"), *report]) == 0
    assert max(error[0] for error in _off(there, tmp_path / "a.toml")[0]) < 0.25
    told = json.loads((tmp_path / "a.json").read_text())
    assert told["clock"] == "shared"
    assert [one["places"] for one in told["arrays"]] == [60, 60, 60]
    straight = replace(there, described=there.right)
    write_recording(tmp_path / "b.mcap", straight, 5)
    clocks = ["calibrate", str(tmp_path / "b.mcap"), "--arrays", "--clocks-only"]
    clocks += [word for ue in range(12) for word in ("--ue", str(ue))]
    assert main([*clocks, "-o", str(tmp_path / "b.toml")]) == 0
    for place, late_s in zip(load_placements(tmp_path / "b.toml"), there.late_s, strict=True):
        assert place.position_m is None
        assert place.offset_s == pytest.approx(late_s, abs=1e-9)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--arrays", "--ue", "3"], "at 1 known places; a pose takes 4"),
        (["--arrays", "--ue", "999"], "has heard no UE whose place is known"),
        (["--arrays", "--check", "x.toml"], "--check cannot be had with --arrays"),
        (["--arrays", "--places", "none.csv"], "--places: none.csv cannot be read"),
        (["--arrays", "--clock", "own", "--clocks-only"], "no clock in common"),
        (["--clocks-only", "--ue", "3"], "go with --arrays"),
    ],
)
def test_mistakes_are_told(
    tmp_path: Path, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "a.mcap", hall(), 0, ues=6)
    assert main(["calibrate", str(tmp_path / "a.mcap"), *words]) == 78
    assert told in capsys.readouterr().err


def test_ues_on_one_line_are_too_few_directions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / "a.mcap", hall(), 0, positions=False, ues=6)
    lines = [f"{ue},{ue},{2 * ue},1.5" for ue in range(6)]
    (tmp_path / "line.csv").write_text("\n".join(["ue,x,y,z", *lines]))
    places = ["--places", str(tmp_path / "line.csv")]
    assert main(["calibrate", str(tmp_path / "a.mcap"), "--arrays", *places]) == 78
    assert "on one straight line only" in capsys.readouterr().err


@pytest.mark.skipif(not (RAYTRACED / "indoor.npz").exists(), reason="ray-traced data is not here")
def test_a_ray_traced_hall(tmp_path: Path) -> None:
    whole, recording = tmp_path / "indoor.mcap", tmp_path / "some.mcap"
    assert main(["import", str(RAYTRACED / "indoor.npz"), str(whole), "--snr-db", "10"]) == 0
    reader = RecordingReader(whole)
    with RecordingWriter(recording, reader.arrays[0], others=reader.arrays[1:], facts=reader.facts) as writer:
        for block in reader.blocks():
            some = block.time_ns // 1_000_000 % 7 == 0
            if some.any():
                writer.write(block.take(some))
    assert main(["calibrate", str(recording), "--arrays", "--json", str(tmp_path / "a.json")]) == 0
    for one in json.loads((tmp_path / "a.json").read_text())["arrays"]:
        assert one["moved_m"] < 0.1  # the description is exact
        assert one["turned_deg"] < 2.5
        assert abs(one["offset_ns"]) < 0.3
