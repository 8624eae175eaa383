"""What once went wrong: frames and UEs that are odd, alone or among others."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from chachart.node.data.csi import CsiBlock
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
