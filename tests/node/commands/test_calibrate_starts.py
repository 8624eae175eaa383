from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from chachart.config.settings import ArraySettings
from chachart.node.commands.main import main
from chachart.node.data.csi import CsiBlock
from chachart.node.files.recording import RecordingReader, RecordingWriter

STARTS, FRAMES = 8, 40
ARRAY = ArraySettings(antennas=3, subcarriers=16, carrier_hz=5.32e9, subcarrier_spacing_hz=625e3).geometry()
PLACES = np.column_stack([np.full(STARTS, 9.0), np.linspace(-5, 5, STARTS), np.full(STARTS, 9.5)])


def frames(flips: np.ndarray, cables: np.ndarray, snr_db: float) -> np.ndarray:
    """Frames (starts, frames, antennas, subcarriers) of a UE in another place at each start."""
    rng = np.random.default_rng(8)
    distance = np.linalg.norm(ARRAY.element_positions() - PLACES[:, None], axis=2)[:, None, :, None]
    csi = np.exp(-2j * np.pi * ARRAY.frequencies_hz * distance / ARRAY.light_speed_m_s)
    csi = csi * np.exp(2j * np.pi * rng.uniform(size=(STARTS, FRAMES, 1, 1)))
    csi = csi * (flips * np.exp(1j * cables))[:, None, :, None]
    noise = rng.standard_normal((*csi.shape, 2)).view(np.complex128)[..., 0]
    return csi + noise * np.sqrt(0.5 * 10 ** (-snr_db / 10))


@pytest.fixture
def flips() -> np.ndarray:
    signs = np.random.default_rng(3).choice([-1, 1], (STARTS, 3))
    signs[:, 0] = signs[0] = 1
    return signs


@pytest.fixture
def recording(tmp_path: Path, flips: np.ndarray) -> Path:
    csi = frames(flips, np.array([0.0, 1.1, -0.7]), 10.0).astype(np.complex64)
    path = tmp_path / "card.mcap"
    with RecordingWriter(path, ARRAY, note={"starts": list(range(0, STARTS * FRAMES, FRAMES))}) as writer:
        for n in range(STARTS):
            where = np.tile(PLACES[n].astype(np.float32), (FRAMES, 1))
            times = np.arange(FRAMES) + n * FRAMES
            writer.write(CsiBlock("lab", n * FRAMES, np.full(FRAMES, 7, np.uint64), times, csi[n], where))
    return path


def signs(path: Path) -> np.ndarray:
    return np.array([start["signs"] for start in json.loads(path.read_text())["starts"]])


def test_a_ue_at_known_places_tells_every_chain(
    recording: Path, tmp_path: Path, flips: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    report, out = tmp_path / "report.json", tmp_path / "out.mcap"
    words = ["calibrate", str(recording), "--per-start", "--ue", "7", "--json", str(report)]
    assert main([*words, "--corrected", str(out)]) == 0
    np.testing.assert_array_equal(signs(report), flips)
    assert "turned by 180 degrees" in capsys.readouterr().out
    before, after = (
        CsiBlock.concatenate(list(RecordingReader(path).blocks())).csi for path in (recording, out)
    )
    undone = np.repeat(flips, FRAMES, axis=0)[:, :, None]
    np.testing.assert_array_equal(after, before * undone)
    assert [turned["signs"] for turned in RecordingReader(out).note["chains_turned"]] == flips.tolist()


def test_without_a_place_it_is_known_up_to_a_turn(recording: Path, tmp_path: Path, flips: np.ndarray) -> None:
    report = tmp_path / "report.json"
    assert main(["calibrate", str(recording), "--per-start", "--json", str(report)]) == 0
    found = signs(report)
    np.testing.assert_array_equal(found[:, 2] * found[:, 0], flips[:, 2] * flips[:, 0])
    assert (found[:, :2] == 1).all()


def test_what_cannot_be_told(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    single = tmp_path / "single.mcap"
    with RecordingWriter(single, ARRAY) as writer:
        for block in RecordingReader(recording).blocks():
            writer.write(block)
    assert main(["calibrate", str(single), "--per-start"]) == 78
    assert "one start only" in capsys.readouterr().err
    assert main(["calibrate", str(recording), "--per-start", "--ue", "8"]) == 78
    assert "no frame of UE 8" in capsys.readouterr().err
    assert main(["calibrate", str(recording), "--corrected", str(tmp_path / "x.mcap"), "--ue", "7"]) == 78
    assert "--corrected goes with --per-start" in capsys.readouterr().err


def test_a_clock_that_steps_back_begins_a_start(tmp_path: Path, flips: np.ndarray) -> None:
    csi = frames(flips, np.zeros(3), 20.0).astype(np.complex64)
    path, report = tmp_path / "card.mcap", tmp_path / "report.json"
    with RecordingWriter(path, ARRAY) as writer:
        for n in range(2):
            ue = np.full(FRAMES, 7, np.uint64)
            writer.write(CsiBlock("lab", n * FRAMES, ue, np.arange(FRAMES, dtype=np.int64), csi[n]))
    words = ["calibrate", str(path), "--per-start", "--ue", "7", "--json", str(report)]
    assert main([*words, "--position", "9,-5,9.5"]) == 0
    assert [start["first_frame"] for start in json.loads(report.read_text())["starts"]] == [0, FRAMES]


def test_a_start_of_which_it_is_not_sure_stays_as_it_is(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    odd, out = tmp_path / "odd.mcap", tmp_path / "out.mcap"
    reader = RecordingReader(recording)
    block = CsiBlock.concatenate(list(reader.blocks()))
    csi = block.csi.copy()
    csi[-FRAMES:, 2] *= np.complex64(1j)
    with RecordingWriter(odd, ARRAY, note=reader.note) as writer:
        writer.write(CsiBlock("lab", 0, block.ue, block.time_ns, csi, block.position))
    assert main(["calibrate", str(odd), "--per-start", "--ue", "7", "--corrected", str(out)]) == 0
    assert "not sure" in capsys.readouterr().out
    after = CsiBlock.concatenate(list(RecordingReader(out).blocks()))
    np.testing.assert_array_equal(after.csi[-FRAMES:], csi[-FRAMES:])
    assert RecordingReader(out).note["chains_turned"][-1]["sure"] is False
