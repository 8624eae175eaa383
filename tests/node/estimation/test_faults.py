"""What once went wrong: frames and UEs that are odd, alone or among others."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from chachart.config.settings import ArraySettings
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.options import SPECTRAL

Build = Callable[..., Any]


def without(block: CsiBlock, antennas: Any, tones: Any) -> CsiBlock:
    csi = block.csi.copy()
    csi[:, antennas, :] = 0
    csi[:, :, tones] = 0
    return CsiBlock(block.array, 0, block.ue, block.time_ns, csi, block.position)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("method", SPECTRAL)
@pytest.mark.parametrize(("antennas", "tones"), [([0], []), ([], [0]), ([0, 1, 8], [0, 16]), ([31], [31])])
def test_antennas_and_tones_that_carry_nothing(
    los: Build, truth: Build, method: str, order: int, antennas: list[int], tones: list[int]
) -> None:
    world = los(16, far=True)
    estimator = ChartEstimator(world.array, theta=method, rho=method, signal_order=order, averaging="mean")
    for _ in range(4):
        update = estimator.update(without(world.block(10.0, np.arange(16)), antennas, tones))
    theta, rho = truth(world)
    off = np.abs(update.theta - theta)
    if (method, order) == ("minnorm", 1) or method != "minnorm":
        assert off.max() < 0.02
    assert np.median(off) < 0.005  # Min-Norm of too high an order has outliers whatever is dead
    assert np.median(np.abs(update.rho - rho)) < 20
    assert estimator.rejected.as_dict() == {}
    for _ in range(60):  # and it recovers
        update = estimator.update(world.block(10.0, np.arange(16)))
    assert update.theta == pytest.approx(theta, abs=0.005)


@pytest.mark.parametrize("subcarriers", [4, 32])
def test_mvdr_without_loading_costs_singular_ues_alone(los: Build, truth: Build, subcarriers: int) -> None:
    """Ones whose covariance cannot be inverted are told apart from ones whose can be."""
    world = los(12, far=True, subcarriers=subcarriers)
    estimator = ChartEstimator(world.array, theta="mvdr", rho="isq", loading=0.0, averaging="mean")
    seen = np.arange(6)
    for _ in range(20):
        estimator.update(world.block(20.0, seen))
    before = estimator.rejected.as_dict()
    block = world.block(20.0, np.arange(12))
    csi = block.csi.copy()
    csi[6:] = csi[6:, :, :1]  # one path and no noise: rank 1
    update = estimator.update(CsiBlock("lab", 0, block.ue, block.time_ns, csi, block.position))
    assert update.ue.tolist() == seen.tolist()
    assert update.theta == pytest.approx(truth(world)[0][:6], abs=0.02)
    assert estimator.rejected.as_dict()["no_estimate"] == before.get("no_estimate", 0) + 6
    assert "untrained" not in estimator.rejected.as_dict()
    assert estimator.spectrum(9) is None
    assert estimator.spectrum(2) is not None


@pytest.mark.parametrize("order", ["mdl", "threshold", 1])
def test_single_element_frames(los: Build, order: Any) -> None:
    world = los(3)
    csi = np.zeros((3, 32, 32), np.complex64)
    csi[0, 3, 4] = csi[1, 0, 0] = csi[2, 31, 31] = 1
    estimator = ChartEstimator(world.array, theta="music", rho="minnorm", signal_order=order)
    for _ in range(3):
        update = estimator.update(csi, ue=[0, 1, 2])
    assert np.isfinite(update.theta).all()


@pytest.mark.parametrize(
    "options",
    [
        *({"theta": m, "rho": m} for m in SPECTRAL),
        {"theta": "joint", "rho": "joint", "phase": "steady"},
        {"theta": "joint", "rho": "joint", "phase": "random"},
        {"rho": "isq", "isq_reference": (100.0, 3.0), "amplitude": "noisy"},
    ],
    ids=str,
)
def test_a_mean_of_very_many_frames_still_moves(los: Build, options: dict[str, Any]) -> None:
    """Single precision drops an addend 2^24 times smaller than the sum."""
    world = los(2, far=True, subcarrier_spacing_hz=312.5e3)
    estimator = ChartEstimator(world.array, averaging="mean", **options)
    frame = world.block(20.0, np.array([0]), phase=False)
    estimator.update(frame)
    alone = estimator.snapshot()
    many = {name: rows.copy() for name, rows in alone.items()}
    for name in many:
        if name.startswith("locator.") and name.endswith("[]") and "tracker" not in name:
            many[name] *= many[name].dtype.type(2**26)
    estimator.restore(many)
    for _ in range(20):
        estimator.update(frame)
    before = estimator.snapshot()
    update = estimator.update(frame)
    after = estimator.snapshot()
    assert update.snapshots[0] > 2**18
    for name, rows in alone.items():
        if name.endswith("bank.rows[]") and "tracker" not in name:
            added = after[name] - before[name]
            assert np.linalg.norm(added - rows) <= 0.1 * np.linalg.norm(rows), name
    assert after["locator.weights.sum.rows[]"] == before["locator.weights.sum.rows[]"] + 1


def plane_waves(array: ArrayGeometry, theta: float, count: int, snr_db: float) -> np.ndarray:
    """Frames (count, N_R, N_S) of plane waves from 200 m away, of random phase, in noise."""
    rng = np.random.default_rng(0)
    m = np.arange(array.antennas) - (array.antennas - 1) / 2
    turns = array.frequencies_hz / array.light_speed_m_s
    path = 200.0 - m[:, None] * array.element_spacing_m * np.cos(theta)
    wave = np.exp(-2j * np.pi * (turns * path + rng.random((count, 1, 1))))
    noise = rng.standard_normal((*wave.shape, 2)).view(np.complex128)[..., 0]
    return wave + noise * 10 ** (-snr_db / 20) / 2**0.5


@pytest.mark.parametrize("method", ["bartlett", "music", "joint"])
@pytest.mark.parametrize("theta_deg", [2.0, 5.0, 20.0, 175.0])
def test_wide_bands_keep_the_ends_of_a_default_array_apart(theta_deg: float, method: Any) -> None:
    """The default spacing is half the shortest wavelength: 5 degrees do not come out as 171.3 +- 0.0."""
    array = ArraySettings(antennas=8, subcarriers=256, subcarrier_spacing_hz=312.5e3).geometry()
    estimator = ChartEstimator(array, theta=method, rho="joint" if method == "joint" else "bartlett")
    frames = plane_waves(array, np.radians(theta_deg), 64, 10.0)
    update = estimator.update(frames, ue=np.arange(64), time_ns=0)
    error = update.theta - np.radians(theta_deg)
    assert np.abs(np.degrees(error)).max() < 3
    assert 0.3 < np.sqrt(np.mean((error / update.theta_std) ** 2)) < 2


@pytest.mark.parametrize(("theta_deg", "snr_db"), [(5.0, 0.0), (175.0, 0.0), (10.0, -10.0), (90.0, 0.0)])
def test_deviations_near_the_ends_say_how_often_an_end_is_taken_for_the_other(
    theta_deg: float, snr_db: float
) -> None:
    array = ArraySettings(antennas=8).geometry()  # hardly any band: both ends look nearly alike
    frames = plane_waves(array, np.radians(theta_deg), 256, snr_db)
    update = ChartEstimator(array, echoes=False).update(frames, ue=np.arange(256), time_ns=0)
    error = float(np.sqrt(np.mean((update.theta - np.radians(theta_deg)) ** 2)))
    told = float(np.sqrt(np.mean(update.theta_std**2)))
    assert 0.5 < error / told < 2


def test_directions_that_look_alike_are_told_so() -> None:
    wide = ArraySettings(antennas=8, subcarriers=256, subcarrier_spacing_hz=312.5e3, element_spacing_m=0.075)
    array = wide.geometry()
    estimator = ChartEstimator(array)
    at_the_end = estimator.update(plane_waves(array, np.radians(5.0), 8, 20.0), ue=np.arange(8), time_ns=0)
    assert (at_the_end.theta_std > 1.0).all()
    abeam = estimator.update(plane_waves(array, np.radians(70.0), 8, 20.0), ue=np.arange(8, 16), time_ns=0)
    assert (abeam.theta_std < 0.01).all()


@pytest.mark.parametrize("height_m", [None, 8.5])
def test_isq_without_a_scale_is_relative(los: Build, truth: Build, height_m: float | None) -> None:
    """Its distances are right but for one factor, are not projected, and say that they are no metres."""
    world = los(20, far=True, height_m=height_m)
    _, rho = truth(world)
    estimator = ChartEstimator(world.array, rho="isq")
    block = world.block(30.0, np.arange(20))
    update = estimator.update(block.csi, ue=block.ue)
    assert update["relative"].tolist() == [1] * 20
    assert np.ptp(np.log(update.rho / np.sqrt(rho))) < 0.1  # s goes as 1 / rho here, rho as 1 / sqrt(s)
    assert np.hypot(update.x, update.y) == pytest.approx(update.rho)
    assert (update.x > 0).all()
    scaled = estimator.update(block)  # these frames tell where the UEs are
    assert "relative" not in scaled.columns
    told = ChartEstimator(world.array, rho="isq", isq_reference=(100.0, 3.0)).update(block.csi, ue=block.ue)
    assert "relative" not in told.columns


def test_directions_alone_are_relative(los: Build) -> None:
    world = los(5, height_m=8.5)
    update = ChartEstimator(world.array, rho="none").update(world.block(20.0, np.arange(5)))
    assert update["relative"].tolist() == [1] * 5
    assert np.hypot(update.x, update.y) == pytest.approx(1.0)
