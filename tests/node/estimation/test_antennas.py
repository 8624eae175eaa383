from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.antennas import FEWEST_FRAMES, AntennaWatch, response

ARRAY = ArrayGeometry("lab", 16, 32, 2e9, 312_500.0, 0.0749481145)


def waves(frames: int, snr_db: float, gains: NDArray[np.float64] | None = None, seed: int = 0) -> CsiBlock:
    """Single plane waves from anywhere, of as many UEs as frames, with noise of the same power everywhere."""
    rng = np.random.default_rng(seed)
    n, s = np.arange(ARRAY.antennas)[:, None], np.arange(ARRAY.subcarriers)
    slopes = rng.uniform(-np.pi, np.pi, (2, frames, 1, 1))
    csi = np.exp(1j * (slopes[0] * n + slopes[1] * s))
    if gains is not None:
        csi = csi * gains[:, None]
    noise = rng.standard_normal((2, *csi.shape)) * 10 ** (-snr_db / 20) / np.sqrt(2)
    csi = csi + noise[0] + 1j * noise[1]
    ue = np.arange(frames, dtype=np.uint64)
    return CsiBlock("lab", 0, ue, np.zeros(frames, np.int64), csi.astype(np.complex64))


def looked(array: ArrayGeometry = ARRAY, looks: int = 12, **changes: Any) -> dict[str, Any]:
    watch = AntennaWatch(array)
    for seed in range(looks):
        watch.look(waves(32, seed=seed, **changes))
    return watch.report()


@pytest.mark.parametrize("snr_db", [0.0, 20.0])
def test_sound_antennas_have_no_fault(snr_db: float) -> None:
    report = looked(snr_db=snr_db)
    assert report["faults"] == {}
    assert np.abs(report["power_db"]).max() < 1
    assert len(report["tone_db"]) == ARRAY.subcarriers


@pytest.mark.parametrize("snr_db", [0.0, 20.0])
def test_dead_and_weak_antennas_are_named_in_noise_too(snr_db: float) -> None:
    gains = np.ones(ARRAY.antennas)
    gains[3], gains[9] = 0.0, 10 ** (-10 / 20)
    report = looked(snr_db=snr_db, gains=gains)
    assert report["faults"] == {"3": "dead", "9": "weak"}
    assert report["coherent_db"][9] == pytest.approx(-10, abs=1.5)


def test_what_the_array_leaves_out_is_no_news() -> None:
    gains = np.ones(ARRAY.antennas)
    gains[3] = 0.0
    assert looked(replace(ARRAY, dead_antennas=(3,)), snr_db=20.0, gains=gains)["faults"] == {}


def test_a_converter_at_its_limit_is_named() -> None:
    watch = AntennaWatch(ARRAY)
    for seed in range(12):
        block = waves(32, snr_db=10.0, seed=seed)
        clipped = block.csi.copy()
        limited = clipped[:, 5]
        limited = np.clip(limited.real, -0.7, 0.7) + 1j * np.clip(limited.imag, -0.7, 0.7)
        clipped[:, 5] = limited
        watch.look(CsiBlock("lab", 0, block.ue, block.time_ns, clipped))
    assert watch.report()["faults"] == {"5": "saturated"}


def test_a_few_frames_say_nothing_yet() -> None:
    watch = AntennaWatch(ARRAY)
    assert watch.report() == {}
    gains = np.ones(ARRAY.antennas)
    gains[3] = 0.0
    watch.look(waves(FEWEST_FRAMES // 4, snr_db=20.0, gains=gains))
    assert watch.report()["faults"] == {}


def test_frames_that_cannot_be_used_change_nothing() -> None:
    watch = AntennaWatch(ARRAY)
    block = waves(8, snr_db=20.0)
    watch.look(CsiBlock("lab", 0, block.ue, block.time_ns, np.full_like(block.csi, np.nan)))
    watch.look(CsiBlock("lab", 0, block.ue, block.time_ns, np.zeros_like(block.csi)))
    assert watch.report() == {}


def test_the_response_of_a_frame_is_its_two_slopes() -> None:
    n, s = np.arange(ARRAY.antennas)[:, None], np.arange(ARRAY.subcarriers)
    found = response(np.exp(1j * (0.3 * n - 0.2 * s)).astype(np.complex64))
    np.testing.assert_allclose(np.diff(np.unwrap(found["antenna_phase"])), 0.3, atol=1e-3)
    np.testing.assert_allclose(np.diff(np.unwrap(found["tone_phase"])), -0.2, atol=1e-3)
    np.testing.assert_allclose(found["antenna_db"], 0, atol=0.01)


def test_a_frame_of_any_size_counts_alike() -> None:
    gains = np.ones(ARRAY.antennas)
    gains[3] = 0.0
    watch = AntennaWatch(ARRAY)
    for seed in range(12):
        block = waves(32, snr_db=20.0, seed=seed, gains=gains)
        watch.look(
            CsiBlock("lab", 0, block.ue, block.time_ns, block.csi * np.float32(10.0 ** (seed * 3 - 18)))
        )
    assert watch.report()["faults"] == {"3": "dead"}
