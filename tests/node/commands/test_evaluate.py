from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from chachart.config.settings import ArraySettings
from chachart.node.commands.main import main
from chachart.node.data.calibration import Calibration
from chachart.node.data.csi import CsiBlock
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.calibration import save_calibration
from chachart.node.files.recording import RecordingReader, RecordingWriter
from chachart.sources.base import EndOfSource
from chachart.sources.simulator import Simulator, SimulatorSettings

UES, FRAMES = 300, 900


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three noisy frames of each of 300 UEs in line of sight."""
    array = ArraySettings(antennas=16, subcarriers=16, subcarrier_spacing_hz=312500.0).geometry()
    settings = SimulatorSettings(ues=UES, frames=FRAMES, frame_rate_hz=0.0, snr_db=20.0)
    path = tmp_path_factory.mktemp("evaluate") / "los.mcap"
    with RecordingWriter(path, array) as writer, Simulator(settings, array) as source:
        try:
            while True:
                block = source.recv(1.0)
                if block is not None:
                    writer.write(block)
        except EndOfSource:
            pass
    return path


def test_figures_are_printed_and_written(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report, chart = tmp_path / "quality.json", tmp_path / "chart.png"
    assert main(["evaluate", str(recording), "--json", str(report), "--chart", str(chart)]) == 0
    figures = json.loads(report.read_text())
    assert (figures["frames"], figures["ues"], figures["k"]) == (FRAMES, UES, 15)
    assert min(figures["tw"], figures["ct"]) > 0.99
    assert 0 < figures["error_m"] < 10
    assert 0 < figures["stress"] < 0.05
    assert figures["seconds"] > 0
    said = capsys.readouterr().out
    for words in (
        f"{FRAMES} frames of {UES} UEs, bartlett/bartlett",
        f"TW        {figures['tw']:.4f}  (K = 15)",
    ):
        assert words in said
    assert chart.read_bytes().startswith(b"\x89PNG")


def test_methods_and_settings(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = tmp_path / "quality.json"
    argv = ["evaluate", str(recording), "--theta", "music", "--rho", "lr", "--json", str(report)]
    assert main([*argv, "--set", "estimator.lr_train_ues=64", "quality.k=7"]) == 0
    assert "music/lr" in capsys.readouterr().out
    assert json.loads(report.read_text())["k"] == 7


def test_a_calibration_undoes_what_the_array_did(recording: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    order = rng.permutation(16)
    calibration = Calibration(
        tuple(order.tolist()), (1.0,) * 16, tuple(rng.uniform(-3, 3, 16)), (1.0,) * 16, (0.0,) * 16
    )
    save_calibration(tmp_path / "cal.toml", calibration, "made up")
    response = np.exp(1j * np.array(calibration.antenna_phase_rad))
    reader = RecordingReader(recording)
    with RecordingWriter(tmp_path / "spoilt.mcap", reader.array) as writer:
        for block in reader.blocks():
            csi = np.empty_like(block.csi)
            csi[:, order] = block.csi * response[:, None].astype(np.complex64)
            writer.write(replace(block, csi=csi))
    tw = {}
    for name, options in (("without", []), ("with", ["--calibration", str(tmp_path / "cal.toml")])):
        report = tmp_path / f"{name}.json"
        assert main(["evaluate", str(tmp_path / "spoilt.mcap"), "--json", str(report), *options]) == 0
        tw[name] = json.loads(report.read_text())["tw"]
    assert tw["with"] > 0.99 > 0.95 > tw["without"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--calibration", "nowhere.toml"], "--calibration: calibration nowhere.toml cannot be read"),
        (["--theta", "music", "--rho", "joint"], 'must be "joint" as rho is'),
        (["--set", "estimator.teta=music"], 'did you mean "theta"?'),
        (["--set", "estimator.signal_order=99", "estimator.theta=music"], "[estimator] signal_order"),
        (["--json", "no/such/folder.json"], "there is no such folder"),
        (["--chart", "no/such/folder.png"], "there is no such folder"),
    ],
)
def test_what_does_not_fit(
    recording: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", str(recording), *options]) == 78
    said = capsys.readouterr().err
    assert words in said
    assert len(said.splitlines()) == 1


def test_a_picture_of_a_kind_that_there_is_not(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", str(recording), "--chart", str(tmp_path / "chart.xyz")]) == 78
    assert "chart.xyz must end in one of .png, .svg, .pdf" in capsys.readouterr().err


def write(path: Path, csi: np.ndarray, position: np.ndarray | None = None) -> Path:
    array = ArraySettings(antennas=4, subcarriers=8).geometry()
    ue = np.arange(len(csi), dtype=np.uint64)
    times = np.arange(len(csi), dtype=np.int64)
    with RecordingWriter(path, array) as writer:
        writer.write(CsiBlock("lab", 0, ue, times, csi.astype(np.complex64), position))
    return path


def test_without_known_positions_there_is_a_chart_but_no_quality(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csi = np.random.default_rng(1).standard_normal((9, 4, 8, 2)).view(np.complex128)[..., 0]
    csi[4] = 0
    path = write(tmp_path / "unknown.mcap", csi)
    report, chart = tmp_path / "quality.json", tmp_path / "chart.png"
    assert main(["evaluate", str(path), "--json", str(report), "--chart", str(chart)]) == 0
    figures = json.loads(report.read_text())
    assert (figures["tw"], figures["error_m"], figures["ues"]) == (None, None, 8)
    assert figures["rejected"] == {"zero": 1}
    said = capsys.readouterr().out
    assert "only 0 UEs have a known position" in said
    assert "rejected  1 (zero)" in said
    assert chart.read_bytes().startswith(b"\x89PNG")


def test_more_neighbours_than_the_measure_allows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csi = np.random.default_rng(1).standard_normal((9, 4, 8, 2)).view(np.complex128)[..., 0]
    position = np.random.default_rng(2).uniform(1, 100, (9, 3)).astype(np.float32)
    path = write(tmp_path / "few.mcap", csi, position)
    assert main(["evaluate", str(path), "--set", "quality.k=5"]) == 0
    assert "quality   k must be at least 1 and below half the 9 UEs" in capsys.readouterr().out


def test_nothing_that_can_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "zero.mcap", np.zeros((5, 4, 8)))
    assert main(["evaluate", str(path)]) == 78
    assert "no frame could be used, of 5 (5 zero)" in capsys.readouterr().err


def test_a_setting_that_would_not_count_is_refused(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", str(recording), "--set", "array.antennas=4"]) == 78
    assert (
        "--set array.antennas=4: only [estimator], [quality], [fusion] and [tracking] count"
        in capsys.readouterr().err
    )


def wifi(path: Path, facts: CaptureFacts, antennas: int = 3, places: np.ndarray | None = None) -> Path:
    """A recording of eight UEs round an array of a Wi-Fi card."""
    at = (0.0, 0.0, 0.0)
    array = ArraySettings(
        antennas=antennas, subcarriers=16, subcarrier_spacing_hz=312500.0, position_m=at
    ).geometry()
    rng = np.random.default_rng(4)
    position = np.column_stack([rng.uniform(5, 50, 8), rng.uniform(-30, 30, 8), np.zeros(8)])
    offset = position[:, None] - array.element_positions()
    d = np.linalg.norm(offset, axis=2)[:, :, None]
    csi = np.exp(-2j * np.pi * array.frequencies_hz * d / array.light_speed_m_s) / d
    csi = np.tile(csi, (5, 1, 1)) * np.exp(2j * np.pi * rng.uniform(size=(40, 1, 1)))
    ue = np.tile(np.arange(8, dtype=np.uint64), 5)
    where = np.tile(position if places is None else places, (5, 1)).astype(np.float32)
    with RecordingWriter(path, array, facts=facts) as writer:
        writer.write(CsiBlock("lab", 0, ue, np.arange(40), csi.astype(np.complex64), where))
    return path


def test_methods_are_those_that_the_capture_allows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    facts = CaptureFacts("random", "relative", "rssi")
    path = wifi(tmp_path / "wifi.mcap", facts)
    report = tmp_path / "report.json"
    assert main(["evaluate", str(path), "--json", str(report)]) == 0
    said = capsys.readouterr().out
    assert "bartlett/isq" in said
    assert "its delays are no distances" in said
    figures = json.loads(report.read_text())
    assert figures["theta_error_deg"] < 1
    assert (figures["theta"], figures["rho"]) == ("bartlett", "isq")
    assert main(["evaluate", str(path), "--rho", "music"]) == 78
    assert 'must be "none", "isq" or "lr"' in capsys.readouterr().err
    assert main(["evaluate", str(wifi(tmp_path / "raw.mcap", CaptureFacts("random", "relative")))]) == 0
    said = capsys.readouterr().out
    assert "bartlett/none" in said
    assert "degrees off" in said
    assert "TW" not in said


def test_one_antenna_without_anything_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = wifi(tmp_path / "one.mcap", CaptureFacts("random", "relative"), antennas=1)
    assert main(["evaluate", str(path)]) == 78
    assert "nothing can be charted: one antenna sees no direction" in capsys.readouterr().err
    path = wifi(tmp_path / "power.mcap", CaptureFacts("random", "relative", "rssi"), antennas=1)
    assert main(["evaluate", str(path)]) == 0
    assert "none/isq" in capsys.readouterr().out


def test_positions_in_degrees_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    places = np.array([48.78, 9.18, 0.0]) + np.random.default_rng(2).uniform(0, 1e-3, (8, 3))
    path = wifi(tmp_path / "degrees.mcap", CaptureFacts(), places=places)
    assert main(["evaluate", str(path)]) == 78
    assert "look like degrees" in capsys.readouterr().err


def test_an_array_that_was_said_to_be_elsewhere(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reader = RecordingReader(recording)
    moved = replace(reader.array, position_m=(900.0, 0.0, 10.0))
    path = tmp_path / "moved.mcap"
    with RecordingWriter(path, moved) as writer:
        for block in reader.blocks():
            writer.write(block)
    report = tmp_path / "report.json"
    assert main(["evaluate", str(path), "--json", str(report)]) == 0
    figures = json.loads(report.read_text())
    assert figures["error_m"] > 800
    assert figures["fit_error_m"] < 10
    assert "(as it is)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "words"), [("t.csv", "recording,methods,tw"), ("t.tex", "los.mcap & bartlett")]
)
def test_a_row_for_a_table(recording: Path, tmp_path: Path, name: str, words: str) -> None:
    assert main(["evaluate", str(recording), "--table", str(tmp_path / name)]) == 0
    assert words in (tmp_path / name).read_text()


def test_a_table_of_a_kind_that_there_is_not(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", str(recording), "--table", str(tmp_path / "t.docx")]) == 78
    assert "must end in one of .csv, .tex" in capsys.readouterr().err


def test_a_distance_scaled_by_its_own_place_is_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    array = ArrayGeometry("wifi", 3, 8, 5.18e9, 312_500.0, 0.029)
    rng = np.random.default_rng(1)
    csi = rng.standard_normal((12, 3, 8)) + 1j * rng.standard_normal((12, 3, 8))
    block = CsiBlock.of(csi, ue=1, time_ns=np.arange(12), position=[3.0, 4.0, 0.0], array="wifi")
    facts = CaptureFacts("random", "relative", "rssi")
    with RecordingWriter(tmp_path / "a.mcap", array, facts=facts) as writer:
        writer.write(block)
    assert main(["evaluate", str(tmp_path / "a.mcap")]) == 0
    out = capsys.readouterr().out
    assert "direction" in out
    assert "m off, median" not in out
    assert main(["evaluate", str(tmp_path / "a.mcap"), "--set", "estimator.isq_reference=[10,50]"]) == 0
    assert "m off, median" in capsys.readouterr().out


def test_a_chart_in_line_of_sight_is_left_as_it_is_by_refinement(recording: Path, tmp_path: Path) -> None:
    report = tmp_path / "refined.json"
    assert main(["evaluate", str(recording), "--refine", "--json", str(report)]) == 0
    figures = json.loads(report.read_text())
    assert figures["refined"]["moved"] <= 3
    assert figures["refined"]["error_m"] == pytest.approx(figures["error_m"], abs=0.05)
