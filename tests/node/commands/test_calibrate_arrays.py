"""Calibrating boards and circles: what is wrong with a description is named, and put right."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chachart.node.commands.main import main
from chachart.node.data.csi import CsiBlock
from chachart.node.data.elements import circle, grid
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.calibrate import spherical
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.symmetries import symmetries
from chachart.node.files.calibration import load_calibration, load_offsets, load_response, save_calibration
from chachart.node.files.recording import RecordingWriter

WAVE_M = 0.2357
POSE: dict[str, Any] = {"position_m": (0.0, 0.0, 2.0), "axis": (0.0, 1.0, 0.0)}
BOARD = ArrayGeometry.of_elements("board", grid(2, 4, WAVE_M / 2), 16, 1.272e9, 1e6, **POSE)
RING = ArrayGeometry.of_elements("ring", circle(5, WAVE_M / 3), 16, 1.272e9, 1e6, **POSE)
ORDERS = {
    "columns are mirrored: left is right": [3, 2, 1, 0, 7, 6, 5, 4],
    "rows are mirrored: top is bottom": [4, 5, 6, 7, 0, 1, 2, 3],
    "turned by 180 degrees": [7, 6, 5, 4, 3, 2, 1, 0],
    "numbered column by column": [0, 2, 4, 6, 1, 3, 5, 7],
}


def capture(
    array: ArrayGeometry, order: list[int], seed: int = 1, delay_s: np.ndarray | None = None
) -> CsiBlock:
    """Frames at 20 dB of 30 UEs in sight, through these inputs with phases and gains of their own."""
    rng = np.random.default_rng(seed)
    place = np.stack([rng.uniform(3, 9, 30), rng.uniform(-6, 6, 30), rng.uniform(0, 4, 30)], axis=1)
    h = spherical(array, place)
    h /= np.sqrt(np.mean(np.abs(h) ** 2, axis=(1, 2), keepdims=True))
    frames = np.tile(h, (4, 1, 1)) * np.exp(2j * np.pi * rng.random((120, 1, 1)))
    frames *= np.exp(1j * rng.uniform(-1, 1, array.antennas))[:, None]
    frames *= rng.uniform(0.8, 1.2, array.antennas)[:, None]
    if delay_s is not None:
        frames *= np.exp(-2j * np.pi * np.outer(delay_s, array.offsets_hz))
    measured = np.empty_like(frames)
    measured[:, order] = frames
    noise = rng.standard_normal((*frames.shape, 2)).view(np.complex128)[..., 0]
    csi = (measured + 0.1 * noise / np.sqrt(2)).astype(np.complex64)
    return CsiBlock.of(
        csi, np.tile(np.arange(30), 4), np.arange(120), np.tile(place, (4, 1)), array=array.name
    )


def calibrated(tmp_path: Path, array: ArrayGeometry, block: CsiBlock) -> tuple[dict[str, Any], float]:
    """The report, and the median error of directions (rad) of a chart with the calibration."""
    path = tmp_path / "capture.mcap"
    with RecordingWriter(path, array) as writer:
        writer.write(block)
    report, output = tmp_path / "report.json", tmp_path / "cal.toml"
    assert main(["calibrate", str(path), "--ue", "0", "-o", str(output), "--json", str(report)]) == 0
    right = replace(array, calibration=load_calibration(output))
    chart = ChartEstimator(right, theta="music", rho="none", averaging="mean").update(block)
    assert chart.position is not None
    truth = array.towards(chart.position)
    azimuth = np.arctan2(truth[:, 0], truth[:, 2])
    return json.loads(report.read_text()), float(np.median(np.abs(chart["azimuth"] - azimuth)))


@pytest.mark.parametrize("wrong", ORDERS)
def test_a_wrong_description_is_named(tmp_path: Path, wrong: str, capsys: pytest.CaptureFixture[str]) -> None:
    report, off = calibrated(tmp_path, BOARD, capture(BOARD, ORDERS[wrong]))
    assert report["wrong"] == wrong
    assert report["swapped"] == []
    assert off < 0.05
    assert f"not as described: {wrong}" in capsys.readouterr().out


def test_a_right_description_and_a_swap_are_told_apart(tmp_path: Path) -> None:
    report, off = calibrated(tmp_path, BOARD, capture(BOARD, list(range(8))))
    assert (report["wrong"], report["swapped"]) == (None, [])
    assert off < 0.05
    (tmp_path / "capture.mcap").unlink()
    report, off = calibrated(tmp_path, BOARD, capture(BOARD, [0, 5, 2, 3, 4, 1, 6, 7]))
    assert (report["wrong"], report["swapped"]) == (None, [[1, 5]])
    assert off < 0.05


@pytest.mark.parametrize(
    ("order", "wrong"),
    [([0, 4, 3, 2, 1], "counted the other way round"), ([1, 2, 3, 4, 0], "turned by")],
)
def test_a_circle_counted_another_way(tmp_path: Path, order: list[int], wrong: str) -> None:
    report, off = calibrated(tmp_path, RING, capture(RING, order))
    assert report["wrong"].startswith(wrong)
    assert off < 0.1


def test_delays_of_single_antennas_are_found(tmp_path: Path) -> None:
    delay_s = np.array([0, 3, -2, 5, 1, 0, -4, 2]) * 1e-9
    report, off = calibrated(tmp_path, BOARD, capture(BOARD, list(range(8)), delay_s=delay_s))
    found = np.array(report["calibration"]["antenna_delay_s"])
    np.testing.assert_allclose(found, delay_s - delay_s.mean(), atol=0.8e-9)
    assert off < 0.05


def test_every_symmetry_maps_the_array_onto_itself() -> None:
    for array in (BOARD, RING, ArrayGeometry("line", 6, 1, 2e9, 1e6, 0.07)):
        orders = symmetries(array)
        assert orders
        for order in orders.values():
            assert sorted(order) == list(range(array.antennas))


def test_offsets_of_a_data_set_are_taken_over(tmp_path: Path) -> None:
    sto, cpo = np.array([0.5, -1.25, 3.0, 0.0]), np.array([0.1, 2.0, -1.0, 0.3])
    (tmp_path / "offsets.json").write_text(json.dumps({"sto": sto.tolist(), "cpo": cpo.tolist()}))
    array = ArrayGeometry.of_elements("a", grid(2, 2, 0.1), 64, 1.272e9, 1e6, tones=tuple(range(10, 74)))
    csi = np.random.default_rng(0).standard_normal((2, 4, 128)).astype(np.float32).view(np.complex64)
    right = csi * np.exp(1j * (2 * np.pi * sto[:, None] * array.tone_numbers / 1024 + cpo[:, None]))
    calibration = load_offsets(tmp_path / "offsets.json", array, band=1024)
    np.testing.assert_allclose(calibration.corrector(array.offsets_hz)(csi), right, atol=1e-4)
    centred = dataclasses.replace(array, tones=tuple(range(10 - 512, 74 - 512)))
    calibration = load_offsets(tmp_path / "offsets.json", centred, band=1024)
    np.testing.assert_allclose(calibration.corrector(centred.offsets_hz)(csi), right, atol=1e-4)
    with RecordingWriter(tmp_path / "a.mcap", array):
        pass
    arguments = [
        "--offsets",
        str(tmp_path / "offsets.json"),
        "--band",
        "1024",
        "-o",
        str(tmp_path / "cal.toml"),
    ]
    assert main(["calibrate", str(tmp_path / "a.mcap"), *arguments]) == 0
    again = load_calibration(tmp_path / "cal.toml").corrector(array.offsets_hz)
    np.testing.assert_allclose(again(csi), right, atol=1e-3)
    with pytest.raises(ValueError, match="is of 4 channels, the array has 2"):
        load_offsets(tmp_path / "offsets.json", ArrayGeometry("b", 2, 4, 1e9, 1e6, 0.1))
    assert load_offsets(tmp_path / "offsets.json", array, 1024, (3, 2, 1, 0)).antenna_phase_rad[0] == -0.3


def test_what_pyespargos_saved_of_combined_boards_is_taken_over(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    numbers = np.arange(-58, 59)
    phase, slope = rng.uniform(-np.pi, np.pi, 16), rng.uniform(-0.1, 0.1, 16)
    common = np.exp(0.3j * np.sin(numbers / 20))
    response = np.exp(1j * (phase[:, None] + slope[:, None] * numbers)) * common
    gains = rng.uniform(0.5, 2, (16, 1))
    np.save(tmp_path / "boards.npy", (gains * response).reshape(2, 2, 4, -1).astype(np.complex64))
    tones = tuple(n for n in range(-56, 57, 2) if n)
    array = ArrayGeometry.of_elements("a", grid(4, 4, 0.06), len(tones), 2.4e9, 312_500.0, tones=tones)
    csi = np.ones((1, 16, len(tones)), np.complex64)
    order = tuple(int(n) for n in rng.permutation(16))
    with RecordingWriter(tmp_path / "a.mcap", array):
        pass
    words = ["--offsets", str(tmp_path / "boards.npy"), "--channels", ",".join(map(str, order))]
    assert main(["calibrate", str(tmp_path / "a.mcap"), *words, "-o", str(tmp_path / "c.toml")]) == 0
    corrector = load_calibration(tmp_path / "c.toml").corrector(array.offsets_hz)
    heard = csi * response[list(order)][:, np.array(tones) + 58].astype(np.complex64)
    right = corrector(heard)
    np.testing.assert_allclose(right / right[:, :1, :1], 1, atol=1e-4)
    with pytest.raises(ValueError, match="has 117 tones, not the array's 0 to 63"):
        load_response(
            tmp_path / "boards.npy", ArrayGeometry.of_elements("b", grid(4, 4, 0.06), 64, 2.4e9, 1e6)
        )
    with pytest.raises(ValueError, match="is of 16 antennas, the array has 2"):
        load_response(tmp_path / "boards.npy", ArrayGeometry("b", 2, 4, 1e9, 1e6, 0.1))
    np.save(tmp_path / "none.npy", np.array(None), allow_pickle=True)
    with pytest.raises(ValueError, match="must be an array"):
        load_response(tmp_path / "none.npy", array)


def test_delays_survive_a_file(tmp_path: Path) -> None:
    calibration = replace(
        load_calibration_of(tmp_path), antenna_delay_s=(1e-9, -1e-9), antenna_gain=(1.0, 1.0)
    )
    save_calibration(tmp_path / "d.toml", calibration, "")
    assert load_calibration(tmp_path / "d.toml").antenna_delay_s == pytest.approx((1e-9, -1e-9))
    with pytest.raises(ValueError, match="need the subcarriers' offsets"):
        calibration.corrector()


def load_calibration_of(tmp_path: Path) -> Any:
    (tmp_path / "o.json").write_text('{"sto": [0, 0], "cpo": [0, 0]}')
    return load_offsets(tmp_path / "o.json", ArrayGeometry("b", 2, 4, 1e9, 1e6, 0.1))
