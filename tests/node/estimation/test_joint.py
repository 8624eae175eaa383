from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import JOINT, WIDE, Multipath, one_path, weaker_first

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation import bounds, quality
from chachart.node.estimation.estimator import ChartEstimator

Build = Callable[..., Any]


@pytest.mark.parametrize("phase", [False, True])
@pytest.mark.parametrize(("spacing", "snr_db"), [(312.5e3, -10), (312.5e3, 20), (9765.625, 0)])
def test_efficient_and_honest_on_one_path(
    los: Build, truth: Build, phase: bool, spacing: float, snr_db: float
) -> None:
    world = los(1500, seed=9, far=True, subcarrier_spacing_hz=spacing)
    estimator = ChartEstimator(
        world.array, **JOINT, averaging="mean", phase="random" if phase else "steady", echoes=False
    )
    chart = world.chart(estimator, snr_db, 10, phase=phase)
    theta, rho = truth(world)
    snr = world.snr * 10 ** (snr_db / 10)
    bound_theta = bounds.theta_std(world.array, theta, snr, 10, stochastic=False)
    bound_rho = bounds.rho_std(world.array, snr, 10, stochastic=False)
    for name, true, bound in (("theta", theta, bound_theta), ("rho", rho, bound_rho)):
        error = getattr(chart, name) - true
        assert np.sqrt(np.mean((error / bound) ** 2)) < 1.05, name
        assert 0.8 < np.mean((error / getattr(chart, f"{name}_std")) ** 2) < 1.25, name


def test_exact_without_noise(los: Build, truth: Build) -> None:
    world = los(70, far=True, **WIDE)
    chart = world.chart(ChartEstimator(world.array, **JOINT), 90.0, 1)
    theta, rho = truth(world)
    assert np.abs(chart.theta - theta).max() < 1e-4
    assert np.abs(chart.rho - rho).max() < 0.1


def test_no_worse_than_bartlett_where_the_band_is_narrow(los: Build, truth: Build) -> None:
    world = los(512)
    errors = {}
    for method in ("joint", "bartlett"):
        chart = world.chart(ChartEstimator(world.array, theta=method, rho=method), 0.0, 10)
        errors[method] = [
            np.sqrt(np.mean((a - b) ** 2))
            for a, b in zip((chart.theta, chart.rho), truth(world), strict=True)
        ]
    assert errors["joint"][0] < 1.02 * errors["bartlett"][0]
    assert errors["joint"][1] < 1.02 * errors["bartlett"][1]


@pytest.mark.parametrize("phase", ["steady", "random", "moving"])
def test_finds_the_first_path_although_its_echoes_are_stronger(los: Build, phase: str) -> None:
    world = weaker_first(los(2, **WIDE).array, 64)
    joint = ChartEstimator(world.array, **JOINT)
    separate = ChartEstimator(world.array)
    for _ in range(10):
        block = world.block(5.0, phase=phase)
        update, other = joint.update(block), separate.update(block)
    theta, rho = world.errors(update)
    assert np.mean((theta < 0.02) & (rho < 10)) > 0.93
    assert np.median(world.errors(other)[1]) > 10


def test_late_echoes_that_wrap_round_are_not_early_ones(los: Build) -> None:
    array = los(2, **WIDE).array
    count = 64
    rho = np.random.default_rng(2).uniform(450, 650, count)
    theta = np.full(count, 1.2)
    wrapped = array.unambiguous_rho_m + 100
    world = Multipath(
        array,
        np.stack([theta, theta + 0.1, theta + 0.15], axis=1),
        np.stack([rho, rho + 120, np.full(count, wrapped)], axis=1),
        np.array([[1.0, 0.8, 0.6]]).repeat(count, axis=0),
    )
    update = ChartEstimator(array, **JOINT).update(world.block(5.0))
    assert np.mean(world.errors(update)[1] < 10) > 0.95


@pytest.mark.parametrize("averaging", ["mean", "exponential"])
@pytest.mark.parametrize("phase", ["auto", "steady", "random"])
def test_frames_of_one_block_are_as_good_as_blocks_of_one_frame(
    los: Build, averaging: str, phase: str
) -> None:
    world = los(6, **WIDE)
    block = world.block(10.0, np.array([0, 1, 2, 0, 0, 3, 1, 4, 5, 5, 0]), phase=phase == "random")
    options: dict[str, Any] = {"averaging": averaging, "memory_frames": 3.0, "phase": phase} | JOINT
    at_once, one_by_one = ChartEstimator(world.array, **options), ChartEstimator(world.array, **options)
    at_once.update(block)
    for i in range(len(block)):
        one_by_one.update(block.take(np.array([i])))
    again = world.block(10.0, np.arange(6), phase=phase == "random")
    a, b = at_once.update(again), one_by_one.update(again)
    assert np.array_equal(a.ue, b.ue)
    for name in ("theta", "rho", "snr", "snapshots", "theta_std"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), rel=2e-3), name


@pytest.mark.parametrize("phase", ["steady", "random"])
def test_a_ue_that_left_comes_back_afresh(los: Build, phase: str) -> None:
    world = one_path(los(2, **WIDE).array, np.array([100.0, 500.0]))
    estimator = ChartEstimator(world.array, **JOINT, phase=phase, max_ues=1)
    for which in (0, 1, 0):
        update = estimator.update(world.block(20.0).take(np.array([which])))
        assert update.rho[0] == pytest.approx(world.rho[which, 0], abs=1)
        assert update.snapshots.tolist() == [1.0]


def test_snr_is_that_of_a_frame_however_frames_are_averaged(los: Build) -> None:
    world = one_path(los(2, **WIDE).array, np.linspace(50, 900, 64))
    for phase in ("steady", "random"):
        estimator = ChartEstimator(world.array, **JOINT, phase=phase)
        for _ in range(20):
            update = estimator.update(world.block(-3.0, phase=phase))
        assert np.mean(update.snr) == pytest.approx(-3, abs=0.3)
        assert update.snapshots == pytest.approx(20, abs=6)


@pytest.mark.parametrize(
    ("antennas", "subcarriers"), [(8, 16), (64, 24), (4, 64), (33, 17), (5, 5), (4, 4), (16, 256)]
)
def test_arrays_of_other_sizes(los: Build, antennas: int, subcarriers: int) -> None:
    array = los(2, antennas=antennas, subcarriers=subcarriers, subcarrier_spacing_hz=10e6 / subcarriers).array
    count = 200
    rho = np.random.default_rng(3).uniform(20, min(0.9 * array.unambiguous_rho_m, 900), count)
    world = one_path(array, rho)
    snr_db = 20 - 10 * np.log10(antennas * subcarriers / 1024)
    estimator = ChartEstimator(array, **JOINT, echoes=False)
    for _ in range(4):
        update = estimator.update(world.block(snr_db))
    for error, std in zip(world.errors(update), (update.theta_std, update.rho_std), strict=True):
        assert 0.65 < np.mean((error / std) ** 2) < 1.5


@pytest.mark.parametrize("element_spacing_m", [0.05, 0.09])
def test_elements_closer_and_wider_than_half_a_wavelength(los: Build, element_spacing_m: float) -> None:
    array = los(2, element_spacing_m=element_spacing_m, **WIDE).array
    world = one_path(array, np.full(50, 300.0), np.linspace(0.9, 2.2, 50))
    update = ChartEstimator(array, **JOINT).update(world.block(10.0))
    assert world.errors(update)[0].max() < 5e-3
    steep = one_path(array, np.full(20, 300.0), np.linspace(0.02, 0.3, 20))
    if element_spacing_m < 0.075:
        update = ChartEstimator(array, **JOINT).update(steep.block(20.0))
        assert steep.errors(update)[0].max() < 0.1


def test_ranges_near_zero_and_near_the_unambiguous_end(los: Build) -> None:
    array = los(2, **WIDE).array
    end = array.unambiguous_rho_m
    rho = np.concatenate([np.linspace(0, 20, 41), np.linspace(end - 30, end - 3, 28)])
    update = ChartEstimator(array, **JOINT).update(one_path(array, rho).block(10.0))
    assert update.rho == pytest.approx(rho, abs=2)
    assert update.rho.min() >= 0


def test_rho_max_limits_the_search(los: Build) -> None:
    array = los(2, **WIDE).array
    rho = np.array([50.0, 299.0, 301.0, 310.0, 600.0, 955.0])
    update = ChartEstimator(array, **JOINT, rho_max_m=300.0).update(one_path(array, rho).block(10.0))
    assert update.rho.max() <= 300
    assert update.rho[:2] == pytest.approx(rho[:2], abs=2)
    assert update.rho[2:4] == pytest.approx(300, abs=2)
    assert np.isfinite(update.theta).all()


def test_nothing_but_noise_is_still_an_estimate(los: Build) -> None:
    world = one_path(los(2, **WIDE).array, np.linspace(50, 900, 64))
    estimator = ChartEstimator(world.array, **JOINT)
    for _ in range(4):
        update = estimator.update(world.block(-60.0))
    for name in ("theta", "rho", "theta_std", "rho_std", "snr"):
        assert np.isfinite(getattr(update, name)).all(), name
    assert update.snr.max() < -10


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"antennas": 3}, JOINT, r'^theta must not be "joint": it takes at least 4 antennas, not 3$'),
        ({"subcarriers": 1}, JOINT, r'^rho must not be "joint": it takes at least 4 subcarriers, not 1$'),
        ({"subcarriers": 4096}, JOINT, r'^theta must not be "joint": it keeps 16 bytes'),
        ({}, {"theta": "joint"}, "^rho must be \"joint\" as theta is.*, not 'bartlett'"),
        ({}, {"rho": "joint", "theta": "music"}, "^theta must be \"joint\" as rho is.*, not 'music'"),
        ({}, JOINT | {"phase": "lunar"}, "^phase must be 'auto', 'steady' or 'random', not 'lunar'"),
    ],
)
def test_what_does_not_fit_is_named(
    los: Build, changes: dict[str, Any], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        ChartEstimator(los(2, **changes).array, **options)


def test_changing_the_method(los: Build) -> None:
    world = los(3, **WIDE)
    estimator = ChartEstimator(world.array)
    estimator.update(world.block(0.0, np.arange(3)))
    estimator.set_method("joint", "joint")
    update = estimator.update(world.block(0.0, np.arange(3)))
    assert (update.method.theta, update.method.rho) == ("joint", "joint")
    assert update.snapshots.tolist() == [1.0] * 3
    with pytest.raises(ValueError, match="theta must be"):
        estimator.set_method("bartlett", "joint")
    assert estimator.method.theta == "joint"


@pytest.mark.parametrize("phase", ["steady", "random"])
def test_spectrum_peaks_at_the_estimate(los: Build, phase: str) -> None:
    world = los(2, far=True, **WIDE)
    estimator = ChartEstimator(world.array, **JOINT, phase=phase)
    update = estimator.update(world.block(20.0, np.arange(2)))
    found = estimator.spectrum(1)
    assert found is not None
    assert found["theta"] == update.theta[1]
    assert found["rho_std"] == update.rho_std[1]
    theta, rho = found["theta_grid_rad"], found["rho_grid_m"]
    assert theta.shape == found["theta_spectrum"].shape == rho.shape == found["rho_spectrum"].shape
    assert theta[np.argmax(found["theta_spectrum"])] == pytest.approx(found["theta"], abs=0.01)
    assert rho[np.argmax(found["rho_spectrum"])] == pytest.approx(found["rho"], abs=3)
    assert found["rho_spectrum"].max() == 1
    assert estimator.spectrum(7) is None


@pytest.mark.parametrize(("channels", "least"), [("qlos", 0.9995), ("qnlos", 0.995)])
def test_reference_channels(channels: str, least: float) -> None:
    """The real simulator's channels at 10 MHz: 2048 UEs, 10 frames each, 0 dB."""
    beside = Path(__file__).parents[4] / "shared" / "data"
    path = Path(os.environ.get("CHACHART_DATA", beside)) / f"quadriga_{channels}_a.npz"
    if not path.exists():
        pytest.skip(f"no reference channels at {path}; CHACHART_DATA tells where they are")
    with np.load(path) as data:
        h, position = data["csi"], data["position"]
    d = 299_792_458.0 / 2e9 / 2
    array = ArrayGeometry("lab", 32, 32, 2e9, 312.5e3, d, position_m=(0.0, -15.5 * d, 10.0), height_m=8.5)
    estimator = ChartEstimator(array, **JOINT)
    rng = np.random.default_rng(0)
    for _ in range(10):
        updates = []
        for i in range(0, len(h), 64):
            noise = rng.standard_normal((64, 32, 64), dtype=np.float32).view(np.complex64)
            ue = np.arange(i, i + 64, dtype=np.uint64)
            csi = h[i : i + 64] + noise * np.float32(0.5**0.5)
            updates.append(
                estimator.update(CsiBlock("lab", 0, ue, np.zeros(64, np.int64), csi, position[i : i + 64]))
            )
    chart = ChartUpdate.concatenate(updates)
    near = quality.neighbourhoods(
        np.stack(array.chart_of(chart.position), axis=1), np.stack([chart.x, chart.y], axis=1), 102
    )
    assert near.tw >= least
    assert near.ct >= least


@pytest.mark.parametrize("phase", ["auto", "random"])
@pytest.mark.parametrize("rho_max_m", [1000.0, 200.0])
def test_frames_without_any_noise_or_structure(los: Build, phase: str, rho_max_m: float) -> None:
    array = los(2, **WIDE).array
    csi = np.zeros((6, 32, 32), np.complex64)
    csi[0] = 1  # the spectrum is exactly 0 at most points
    csi[1, 3, 4] = 1  # it is the same everywhere
    csi[2, 3] = 1j
    csi[3, :, 4] = 1e-13
    csi[4] = (-1.0) ** np.arange(32) * 1e12
    csi[5] = one_path(array, np.array([150.0])).waves[0, 0]
    block = CsiBlock("lab", 0, np.arange(6, dtype=np.uint64), np.zeros(6, np.int64), csi)
    estimator = ChartEstimator(array, **JOINT, phase=phase, rho_max_m=rho_max_m)
    for _ in range(3):
        update = estimator.update(block)
        assert len(update) == 6
        for name in ("theta", "rho", "theta_std", "rho_std", "snr"):
            assert np.isfinite(getattr(update, name)).all(), name
    assert update.rho[5] == pytest.approx(150, abs=0.1)
