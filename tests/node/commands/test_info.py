from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chart_logs import near_truth, write_chart_log
from mcap.writer import CompressionType, Writer

from chachart.config.settings import ArraySettings
from chachart.node.commands.main import main
from chachart.node.data.calibration import Calibration
from chachart.node.data.csi import CsiBlock
from chachart.node.files.recording import RecordingWriter


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    array = ArraySettings(name="roof", antennas=4, subcarriers=8, height_m=8.5).geometry()
    path = tmp_path / "capture.mcap"
    ue = np.arange(6, dtype=np.uint64) % 3
    times = 1_700_000_000_000_000_000 + np.arange(6) * 500_000_000
    with RecordingWriter(path, array, note={"imported_from": "x.npz", "snr_db": 3.0}) as writer:
        writer.write(CsiBlock("roof", 0, ue, times, np.ones((6, 4, 8), np.complex64)))
    return path


def test_what_a_recording_holds(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(recording)]) == 0
    said = capsys.readouterr().out
    for words in (
        "6 of 3 UEs",
        "2023-11-14 22:13:20.000 UTC",
        "(2.500 s)",
        "properly",
        "roof: 4 antennas 0.07495 m apart",
        "axis (0, 1, 0), looks to (1, 0, 0)",
        "8.5 m above the UEs",
        "2000 MHz",
        "8, 9.76562 kHz apart",
        "x.npz",
    ):
        assert words in said


def test_a_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ones, phases = (1.0,) * 4, (0.1, -0.1, 0.1, 2 * np.pi - 0.1)
    calibration = Calibration((0, 2, 1, 3), ones, phases, (1.0,) * 8, (0.0,) * 8)
    array = replace(ArraySettings(antennas=4, subcarriers=8).geometry(), calibration=calibration)
    RecordingWriter(tmp_path / "a.mcap", array).close()
    assert main(["info", str(tmp_path / "a.mcap")]) == 0
    said = capsys.readouterr().out
    assert "antenna phases 5.7 degrees rms, 2 antennas on others' inputs" in said
    assert "0 of 0 UEs" in said


def test_as_json(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(recording), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert (values["frames"], values["ues"], values["seconds"]) == (6, 3, 2.5)
    assert values["closed_properly"] is True
    assert values["array"]["antennas"] == 4
    assert values["note"] == {"imported_from": "x.npz", "snr_db": 3.0}


def test_a_recording_cut_short(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = recording.read_bytes()
    recording.write_bytes(whole[: whole.index(b"chachart.totals")])
    assert main(["info", str(recording)]) == 0
    assert "the writer was killed" in capsys.readouterr().out


def test_no_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text.mcap").write_text("no recording")
    for name in ("text.mcap", "nowhere.mcap"):
        assert main(["info", str(tmp_path / name)]) == 78
        said = capsys.readouterr().err
        assert name in said
        assert len(said.splitlines()) == 1


def test_a_chart_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_chart_log(tmp_path / "log.mcap", near_truth(3))
    assert main(["info", str(tmp_path / "log.mcap")]) == 0
    said = capsys.readouterr().out
    for words in ("3 rows of 3 UEs", "music/bartlett (3 rows)", "lab: 8 antennas"):
        assert words in said
    assert main(["info", str(tmp_path / "log.mcap"), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert (values["rows"], values["ues"], values["damaged"]) == (3, 3, {})
    assert values["end_ns"] - values["start_ns"] == 2 * 10**7


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_what_other_programs_wrote_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], compression: CompressionType
) -> None:
    path = tmp_path / "robot.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"")
        channel = writer.register_channel("/imu", "cdr", schema)
        writer.add_message(channel, 1, b"data", 1)
        writer.finish()
    assert main(["info", str(path)]) == 78
    assert "(it has sensor_msgs/msg/Imu)" in capsys.readouterr().err
