import json
from dataclasses import replace

import numpy as np
import pytest

from chachart.config.settings import ArraySettings
from chachart.node.commands.main import main
from chachart.node.commands.shared.calibrating import read
from chachart.node.data.calibration import Calibration
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.files.calibration import load_calibration
from chachart.node.files.recording import RecordingReader, RecordingWriter
from chachart.node.runtime.plan import resolve_array
from chachart.node.runtime.processor import BlockProcessor, FrameClock
from chachart.sources.base import EndOfSource
from chachart.sources.recording import Recording, RecordingSettings
from chachart.sources.simulator import Simulator, SimulatorSettings

ARRAY = ArraySettings(antennas=32, subcarriers=8, subcarrier_spacing_hz=312_500.0).geometry()
UES = 60
REFERENCE = 0


@pytest.fixture(scope="module")
def clean() -> CsiBlock:
    """Ten frames at 0 dB of each UE, from a receiver with no fault; UE 0 is the nearest."""
    settings = SimulatorSettings(
        ues=UES, layout="uniform", frame_rate_hz=0, frames=10 * UES, random_phase=True, seed=2, snr_db=0
    )
    blocks = []
    with Simulator(settings, ARRAY) as source:
        while True:
            try:
                blocks.append(source.recv(10.0))
            except EndOfSource:
                break
    block = CsiBlock.concatenate(blocks)
    nearest = block.ue == block.ue[np.argmin(np.linalg.norm(block.position, axis=1))]
    ue = np.where(nearest, REFERENCE, np.where(block.ue == REFERENCE, block.ue[nearest][0], block.ue))
    return replace(block, ue=ue.astype(np.uint64))


def faulty(clean: CsiBlock, swaps, seed: int = 1) -> CsiBlock:
    """The same through swapped cables, with phase errors of 30 deg, gain errors of 1 dB, and a delay."""
    rng = np.random.default_rng(seed)
    order = np.arange(ARRAY.antennas)
    for i, j in swaps:
        order[[i, j]] = order[[j, i]]
    antenna = np.exp(1j * np.radians(30) * rng.standard_normal(ARRAY.antennas))
    antenna *= 10 ** (rng.standard_normal(ARRAY.antennas) / 20)
    delay = np.exp(-2j * np.pi * ARRAY.subcarrier_spacing_hz * np.arange(ARRAY.subcarriers) * 160e-9)
    measured = np.empty_like(clean.csi)
    measured[:, order] = clean.csi * antenna[:, None] * delay
    return replace(clean, csi=measured)


def recorded(path, block: CsiBlock):
    with RecordingWriter(path, ARRAY) as writer:
        writer.write(block)
    return str(path)


def errors(block: CsiBlock, calibration: Calibration | None) -> tuple[float, float]:
    """RMS error of theta (rad) and median error of rho (m) over all UEs."""
    chart = ChartEstimator(replace(ARRAY, calibration=calibration), averaging="mean").update(block)
    theta, rho = ARRAY.theta_rho(chart.position)
    return float(np.sqrt(np.mean((chart.theta - theta) ** 2))), float(np.median(np.abs(chart.rho - rho)))


def calibrated(path, *arguments) -> tuple[dict, Calibration]:
    report, output = path.with_suffix(".json"), path.with_suffix(".toml")
    assert main(["calibrate", str(path), *arguments, "-o", str(output), "--json", str(report)]) == 0
    return json.loads(report.read_text()), load_calibration(output)


@pytest.mark.parametrize("swaps", [[], [(3, 17)], [(7, 8)], [(0, 31), (12, 20)]])
def test_swapped_cables_are_named_and_theta_is_as_good_as_before(tmp_path, capsys, clean, swaps):
    block = faulty(clean, swaps)
    path = tmp_path / "capture.mcap"
    recorded(path, replace(block, position=np.where(block.ue[:, None] == REFERENCE, block.position, np.nan)))
    report, calibration = calibrated(path, "--ue", str(REFERENCE))
    assert report["swapped"] == [list(pair) for pair in swaps]
    assert report["sure"]
    assert report["suspects"] == []
    said = capsys.readouterr().out
    for i, j in swaps:
        assert f"antennas {i} and {j} are swapped" in said
    theta, rho = errors(block, calibration)
    best_theta, best_rho = errors(clean, None)
    assert theta < 1.2 * best_theta < errors(block, None)[0]
    assert rho < 1.5 * best_rho + 0.5
    assert max(report["off_after_deg"]) < 15 < max(report["off_before_deg"])


def test_subcarriers_that_carry_nothing_are_left_as_they_are(tmp_path, capsys, clean):
    block = faulty(clean, [(3, 17)])
    block.csi[:, :, [0, 4]] = 0
    path = tmp_path / "capture.mcap"
    recorded(path, block)
    report, calibration = calibrated(path, "--ue", str(REFERENCE))
    assert report["swapped"] == [[3, 17]]
    assert report["silent"] == [0, 4]
    assert "subcarriers 0, 4 carry nothing" in capsys.readouterr().out
    assert [calibration.subcarrier_gain[k] for k in (0, 4)] == [1.0, 1.0]
    assert np.isfinite(calibration.subcarrier_phase_rad).all()
    assert errors(block, calibration)[0] < 1.5 * errors(clean, None)[0]


def test_a_known_place_stays_known_where_later_frames_do_not_tell_it(tmp_path, clean):
    """Places of other UEs help to find the order; they are told by one frame of each here."""
    block = faulty(clean, [(3, 17)])
    first = np.zeros(len(block), bool)
    first[np.unique(block.ue, return_index=True)[1]] = True
    told = np.where((first | (block.ue == REFERENCE))[:, None], block.position, np.nan).astype(np.float32)
    path = tmp_path / "capture.mcap"
    with RecordingWriter(path, ARRAY) as writer:
        for start in range(0, len(block), 100):
            writer.write(replace(block, position=told).cut(start, min(start + 100, len(block))))
    capture = read(RecordingReader(path), [REFERENCE])
    assert np.isfinite(capture.position).all()


def test_the_place_may_be_said_instead(tmp_path, clean):
    block = faulty(clean, [(3, 17)])
    path = tmp_path / "capture.mcap"
    recorded(path, replace(block, position=None))
    place = ",".join(str(v) for v in block.position[block.ue == REFERENCE][0].tolist())
    report, calibration = calibrated(path, "--ue", str(REFERENCE), "--position", place)
    assert report["swapped"] == [[3, 17]]
    assert errors(block, calibration)[0] < 1.2 * errors(clean, None)[0]


def test_one_place_alone_may_be_enough(tmp_path, capsys, clean):
    alone = clean.take(clean.ue == REFERENCE)
    path = tmp_path / "capture.mcap"
    u = ARRAY.theta_phase * np.cos(ARRAY.theta_rho(alone.position[0])[0])
    apart = next(d for d in range(5, 20) if abs(np.angle(np.exp(1j * u * d))) > np.radians(140))
    recorded(path, faulty(alone, [(4, 4 + apart)]))
    report, _ = calibrated(path, "--ue", str(REFERENCE))
    assert report["swapped"] == [[4, 4 + apart]]
    assert not report["sure"]
    assert "judging from one place" in capsys.readouterr().out


def test_check_says_which_cable_was_swapped_since(tmp_path, capsys, clean):
    before = tmp_path / "before.mcap"
    recorded(before, faulty(clean, []))
    calibrated(before, "--ue", str(REFERENCE))
    later = faulty(clean, [])
    csi = later.csi.copy()
    csi[:, [9, 22]] = csi[:, [22, 9]]
    path = recorded(tmp_path / "later.mcap", replace(later, csi=csi))
    capsys.readouterr()
    assert main(["calibrate", path, "--check", str(before.with_suffix(".toml"))]) == 0
    said = capsys.readouterr().out
    assert "antennas 9 and 22 are swapped" in said
    assert "antenna 9 is" in said
    assert "antenna 22 is" in said
    assert main(["calibrate", str(before), "--check", str(before.with_suffix(".toml"))]) == 0
    assert "no antenna stands out" in capsys.readouterr().out


def test_a_recording_carries_its_calibration(tmp_path, capsys, clean):
    calibration = Calibration.order_only(tuple(range(31, -1, -1)), 8)
    with RecordingWriter(tmp_path / "a.mcap", replace(ARRAY, calibration=calibration)) as writer:
        writer.write(clean)
    assert RecordingReader(tmp_path / "a.mcap").array.calibration == calibration
    assert main(["info", str(tmp_path / "a.mcap")]) == 0
    assert "32 antennas on others' inputs" in capsys.readouterr().out


def figures(path, tmp_path, *arguments) -> dict:
    assert main(["evaluate", path, "--json", str(tmp_path / "figures.json"), *arguments]) == 0
    return json.loads((tmp_path / "figures.json").read_text())


def test_evaluate_and_the_node_undo_it(tmp_path, clean):
    block = faulty(clean, [(3, 17), (7, 8)])
    path = recorded(tmp_path / "capture.mcap", block)
    calibrated(tmp_path / "capture.mcap", "--ue", str(REFERENCE))
    as_it_is = figures(path, tmp_path)["error_m"]
    undone = figures(path, tmp_path, "--calibration", str(tmp_path / "capture.toml"))["error_m"]
    best = figures(recorded(tmp_path / "clean.mcap", clean), tmp_path)["error_m"]
    assert undone < 1.2 * best < as_it_is
    table = {"antennas": 32, "subcarriers": 8, "subcarrier_spacing_hz": 312_500.0}
    settings = ArraySettings(**table, calibration=tmp_path / "capture.toml")
    source = RecordingSettings(path=path)
    array = resolve_array(settings, Recording, source)
    theta, _ = ARRAY.theta_rho(block.position[:UES])
    processor = BlockProcessor(array, {"averaging": "mean"}, FrameClock(live=False))
    chart = processor.process(block, "bartlett", "bartlett").update
    assert np.sqrt(np.mean((chart.theta - theta) ** 2)) < 1.2 * errors(clean, None)[0]


def test_a_calibration_in_the_configuration_goes_before_the_recordings_own(tmp_path, clean):
    own = Calibration.order_only(tuple(range(31, -1, -1)), 8)
    with RecordingWriter(tmp_path / "a.mcap", replace(ARRAY, calibration=own)) as writer:
        writer.write(clean)
    source = RecordingSettings(path=tmp_path / "a.mcap")
    table = {"antennas": 32, "subcarriers": 8, "subcarrier_spacing_hz": 312_500.0}
    assert resolve_array(ArraySettings(**table), Recording, source).calibration == own
    order = (1, 0, *range(2, 32))
    told = resolve_array(ArraySettings(**table, antenna_order=order), Recording, source)
    assert told.calibration == Calibration.order_only(order, 8)
    with pytest.raises(SetupError, match=r"\[array\]: antenna_order must hold each of 0 to 1 once"):
        resolve_array(ArraySettings(**table, antenna_order=(1, 1)), Recording, source)
    with pytest.raises(SetupError, match=r"\[array\]: the calibration is of 2 antennas"):
        resolve_array(ArraySettings(**table, antenna_order=(1, 0)), Recording, source)


def test_a_cable_that_is_not_connected_is_named(tmp_path, capsys, clean):
    csi = clean.csi.copy()
    csi[:, 5] = 0
    path = recorded(tmp_path / "capture.mcap", replace(clean, csi=csi))
    assert main(["calibrate", path, "--ue", str(REFERENCE)]) == 78
    assert "input 5 measures nothing" in capsys.readouterr().err


def test_frames_of_nonsense_are_passed_over(tmp_path, clean):
    block = faulty(clean, [(3, 17)])
    csi = block.csi.copy()
    csi[::50] = np.nan
    path = tmp_path / "capture.mcap"
    recorded(path, replace(block, csi=csi))
    report, _ = calibrated(path, "--ue", str(REFERENCE))
    assert report["swapped"] == [[3, 17]]


def test_a_recording_without_frames_is_said_so(tmp_path, capsys):
    with RecordingWriter(tmp_path / "empty.mcap", ARRAY):
        pass
    assert main(["calibrate", str(tmp_path / "empty.mcap"), "--ue", "1"]) == 78
    assert "holds no frame that can be used" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--ue", "-1"], ["--ue", str(1 << 64)], ["--position", "1,2"]])
def test_what_is_no_number_is_refused(capsys, arguments):
    with pytest.raises(SystemExit):
        main(["calibrate", "x.mcap", *arguments])
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "say either --ue ID"),
        (["--ue", "0", "--check", "x.toml"], "say either --ue ID"),
        (["--ue", "0", "--ue", "1", "--position", "1,2,3"], "give --ue once"),
        (["--ue", "99999"], "no frame of UE 99999; it has 0, 1,"),
        (["--ue", "1"], "say --position X,Y,Z"),
        (["--ue", "0", "--position", "0,0,10"], "closer than a wavelength"),
        (["--ue", "0", "-o", "/nowhere/cal.toml"], "/nowhere/cal.toml cannot be written"),
        (["--check", "/nowhere/cal.toml"], "/nowhere/cal.toml cannot be read"),
    ],
)
def test_mistakes_end_in_one_line(tmp_path, capsys, clean, arguments, said):
    position = np.where(clean.ue[:, None] == REFERENCE, clean.position, np.nan)
    path = recorded(tmp_path / "capture.mcap", replace(clean, position=position))
    assert main(["calibrate", path, *arguments]) == 78
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error
