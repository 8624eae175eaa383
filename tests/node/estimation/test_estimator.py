from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from chachart.node.data.csi import CsiBlock
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.options import SPECTRAL

Build = Callable[..., Any]


@pytest.mark.parametrize("method", SPECTRAL)
def test_exact_without_noise(los: Build, truth: Build, method: str) -> None:
    world = los(70, far=True)
    chart = world.chart(ChartEstimator(world.array, theta=method, rho=method), 90.0, 1)
    theta, rho = truth(world)
    assert np.abs(chart.theta - theta).max() < 1e-4
    assert np.abs(chart.rho - rho).max() < 0.1


def test_one_row_a_ue_in_order_of_first_appearance(los: Build) -> None:
    world = los(5)
    update = ChartEstimator(world.array).update(world.block(0.0, np.array([3, 1, 3, 0, 1, 3])))
    assert update.ue.tolist() == [3, 1, 0]
    assert update.snapshots == pytest.approx([3, 2, 1], abs=0.05)
    assert np.array_equal(update.position, world.position[[3, 1, 0]].astype(np.float32))


@pytest.mark.parametrize("averaging", ["mean", "exponential"])
@pytest.mark.parametrize("rho", ["bartlett", "music", "isq", "lr"])
@pytest.mark.parametrize("amplitude", ["debiased", "coherent", "noisy"])
def test_frames_of_one_block_are_as_good_as_blocks_of_one_frame(
    los: Build, averaging: str, rho: str, amplitude: str
) -> None:
    world = los(6)
    block = world.block(0.0, np.array([0, 1, 2, 0, 0, 3, 1, 4, 5, 5, 0]))
    options: dict[str, Any] = {"averaging": averaging, "memory_frames": 3.0, "rho": rho}
    options |= {"amplitude": amplitude, "isq_reference": (100.0, 3.0)}
    at_once, one_by_one = ChartEstimator(world.array, **options), ChartEstimator(world.array, **options)
    got = at_once.update(block)
    last = {}
    for i in range(len(block)):
        update = one_by_one.update(block.take(np.array([i])))
        last |= {int(update.ue[j]): j for j in range(len(update))}
    again = world.block(0.0, np.arange(6))
    a, b = at_once.update(again), one_by_one.update(again)
    assert np.array_equal(a.ue, b.ue)
    for name in ("theta", "rho", "snr", "snapshots"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), rel=2e-3), name
    assert set(got.ue.tolist()) <= set(range(6))


def test_plain_arrays_are_as_good_as_a_block(los: Build) -> None:
    world = los(4)
    block = world.block(0.0, np.array([0, 1, 1, 3]), time_ns=7)
    whole, plain = ChartEstimator(world.array), ChartEstimator(world.array)
    want = whole.update(block)
    got = plain.update(block.csi.astype(np.complex128), ue=[0, 1, 1, 3], time_ns=7, position=block.position)
    assert got.array == "lab"
    for name in want.columns:
        assert np.array_equal(want[name], got[name], equal_nan=True), name
    assert plain.update(block.csi[0], ue=9).ue.tolist() == [9]
    with pytest.raises(TypeError, match="whose frames"):
        plain.update(block.csi)  # type: ignore[call-overload]
    with pytest.raises(TypeError, match="a block has its own"):
        plain.update(block, ue=block.ue)  # type: ignore[call-overload]
    with pytest.raises(ValueError, match="ue must be"):
        plain.update(block.csi, ue=[1])


def test_frames_that_carry_nothing_or_nonsense_are_rejected(los: Build) -> None:
    world = los(4)
    block = world.block(0.0, np.arange(4))
    csi = block.csi.copy()
    csi[0] = 0
    csi[1, 3, 3] = np.nan
    csi[2, 0, 0] = np.inf
    estimator = ChartEstimator(world.array)
    update = estimator.update(CsiBlock("lab", 0, block.ue, block.time_ns, csi, block.position))
    assert update.ue.tolist() == [3]
    assert estimator.rejected.as_dict() == {"zero": 1, "not_finite": 2}
    assert estimator.ues == 1
    nothing = estimator.update(CsiBlock("lab", 0, block.ue[:1], block.time_ns[:1], csi[:1]))
    assert len(nothing) == 0
    short = estimator.update(CsiBlock("lab", 0, block.ue, block.time_ns, csi[:, :8].copy()))
    assert len(short) == 0
    assert estimator.rejected.as_dict() == {"zero": 2, "not_finite": 2, "shape": 4}


def test_lr_publishes_nothing_before_it_is_trained(los: Build) -> None:
    world = los(20)
    block = world.block(0.0, np.arange(20))
    unknown = CsiBlock("lab", 0, block.ue, block.time_ns, block.csi)
    estimator = ChartEstimator(world.array, rho="lr")
    assert len(estimator.update(unknown)) == 0
    assert estimator.rejected.as_dict() == {"untrained": 20}
    assert len(estimator.update(block)) == 20
    assert len(estimator.update(unknown)) == 20


def test_position_is_the_last_known(los: Build) -> None:
    world = los(2)
    estimator = ChartEstimator(world.array)
    block = world.block(0.0, np.array([0, 0, 1]))
    position = block.position.copy()
    position[1] = np.nan
    update = estimator.update(CsiBlock("lab", 0, block.ue, block.time_ns, block.csi, position))
    assert np.array_equal(update.position, position[[0, 2]])
    later = estimator.update(CsiBlock("lab", 0, block.ue, block.time_ns, block.csi))
    assert np.array_equal(later.position, position[[0, 2]])
    late = np.full(3, 11 * 10**9)
    much_later = estimator.update(CsiBlock("lab", 0, block.ue, late, block.csi))
    assert np.isnan(much_later.position).all()


@pytest.mark.parametrize("rho", ["isq", "lr"])
def test_positions_train_only_with_the_frame_that_tells_them(los: Build, rho: str) -> None:
    """UEs that have moved on since their position was known teach nothing wrong."""
    world = los(30, far=True)
    undisturbed, disturbed = (ChartEstimator(world.array, rho=rho, memory_frames=1.0) for _ in range(2))
    block = world.block(40.0, np.arange(30))
    for estimator in (undisturbed, disturbed):
        estimator.update(block)
    moved = np.roll(np.arange(15), 7)
    for _ in range(5):
        disturbed.update(world.block(40.0, moved).csi, ue=np.arange(15), time_ns=1)
    probe = world.block(40.0, np.arange(15, 30))
    a, b = (e.update(probe.csi, ue=probe.ue, time_ns=2) for e in (undisturbed, disturbed))
    assert np.array_equal(a.rho, b.rho)


def test_forgetting(los: Build) -> None:
    world = los(3)
    estimator = ChartEstimator(world.array, forget_after_s=1.0)
    estimator.update(world.block(0.0, np.array([0, 1]), time_ns=0))
    estimator.update(world.block(0.0, np.array([2]), time_ns=1_500_000_000))
    assert sorted(estimator.forget(2_000_000_000).tolist()) == [0, 1]
    assert estimator.ues == 1
    assert estimator.spectrum(0) is None
    back = estimator.update(world.block(0.0, np.array([0]), time_ns=3))
    assert back.snapshots.tolist() == [1.0]


def test_the_longest_unseen_makes_room_and_comes_back_afresh(los: Build) -> None:
    world = los(4)
    estimator = ChartEstimator(world.array, max_ues=2, averaging="mean")
    for t, ue in enumerate([0, 0, 1, 2]):
        estimator.update(world.block(0.0, np.array([ue]), time_ns=t))
    assert estimator.ues == 2
    assert estimator.update(world.block(0.0, np.array([0]), time_ns=9)).snapshots.tolist() == [1.0]


@pytest.mark.parametrize("method", SPECTRAL)
@pytest.mark.parametrize("scale", [1e-15, 1e12])
def test_any_unit_of_amplitude_will_do(los: Build, method: str, scale: float) -> None:
    world = los(40)
    block = world.block(0.0, np.arange(40))
    scaled = CsiBlock("lab", 0, block.ue, block.time_ns, block.csi * np.float32(scale))
    options = {"theta": method, "rho": method, "signal_order": 2, "averaging": "mean"}
    expected, got = ChartEstimator(world.array, **options), ChartEstimator(world.array, **options)
    for _ in range(3):
        a, b = expected.update(block), got.update(scaled)
    for name in ("theta", "rho", "snr"):
        assert getattr(b, name) == pytest.approx(getattr(a, name), rel=2e-3), name


def test_a_frame_beyond_single_precision_is_rejected(los: Build) -> None:
    world = los(2)
    block = world.block(0.0, np.arange(2))
    csi = block.csi * np.array([1e-17, 1e17], np.float32)[:, None, None]
    estimator = ChartEstimator(world.array)
    assert len(estimator.update(CsiBlock("lab", 0, block.ue, block.time_ns, csi))) == 0
    assert estimator.rejected.as_dict() == {"out_of_range": 2}


def test_a_block_of_more_ues_than_are_kept(los: Build) -> None:
    world = los(6)
    estimator = ChartEstimator(world.array, max_ues=2)
    update = estimator.update(world.block(20.0, np.array([0, 1, 2, 3, 3, 4, 5])))
    assert update.ue.tolist() == [0, 1, 2, 3, 4, 5]
    assert np.isfinite(update.theta).all()
    assert estimator.ues == 2


def test_exponential_averaging_follows_a_ue_that_moves(los: Build, truth: Build) -> None:
    world = los(2, far=True)
    estimator = ChartEstimator(world.array, memory_frames=4.0)
    theta, _ = truth(world)
    for t in range(40):
        block = world.block(10.0, np.array([int(t >= 20)]))
        update = estimator.update(CsiBlock("lab", 0, np.zeros(1, np.uint64), block.time_ns, block.csi))
    assert update.theta[0] == pytest.approx(theta[1], abs=0.01)
    assert update.snapshots[0] == pytest.approx(4.0, rel=0.01)


def test_set_method(los: Build) -> None:
    world = los(3)
    estimator = ChartEstimator(world.array)
    estimator.update(world.block(0.0, np.arange(3)))
    estimator.set_method("music", "isq")
    update = estimator.update(world.block(0.0, np.arange(3)))
    assert (update.method.theta, update.method.rho) == ("music", "isq")
    assert update.snapshots.tolist() == [1.0] * 3
    with pytest.raises(ValueError, match="theta"):
        estimator.set_method("nothing", "isq")
    assert estimator.method.theta == "music"


@pytest.mark.parametrize("method", SPECTRAL)
def test_spectrum_peaks_at_the_estimate(los: Build, method: str) -> None:
    world = los(2, far=True)
    estimator = ChartEstimator(world.array, theta=method, rho=method)
    update = estimator.update(world.block(20.0, np.arange(2)))
    found = estimator.spectrum(1)
    assert found is not None
    assert found["theta"] == update.theta[1]
    assert found["rho_std"] == update.rho_std[1]
    assert found["theta_grid_rad"][np.argmax(found["theta_spectrum"])] == pytest.approx(
        found["theta"], abs=0.01
    )
    assert found["rho_grid_m"][np.argmax(found["rho_spectrum"])] == pytest.approx(found["rho"], abs=3)
    assert estimator.spectrum(7) is None
    assert estimator.spectrum(-1) is None


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"subcarriers": 1}, {"rho": "music"}, r'^rho must be "isq", "lr" or "none": with 1 subcarrier'),
        ({"subcarriers": 1024}, {"rho": "mvdr"}, r'^rho must be "bartlett": mvdr keeps 1024 x 1024'),
        ({}, {"theta": "music", "signal_order": 32}, "^signal_order must be below 32"),
    ],
)
def test_methods_that_do_not_fit_the_array(
    los: Build, changes: dict[str, Any], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        ChartEstimator(los(2, **changes).array, **options)


def test_many_subcarriers(los: Build, truth: Build) -> None:
    world = los(3, far=True, subcarriers=300)
    chart = world.chart(ChartEstimator(world.array), 60.0, 1)
    assert chart.rho == pytest.approx(truth(world)[1], abs=0.1)


@pytest.mark.parametrize("rho", ["bartlett", "mvdr", "minnorm", "music", "joint"])
def test_delays_of_packet_detection_are_called_no_distance(rho: Any) -> None:
    array = ArrayGeometry("lab", 8, 6, 2e9, 1e6, 0.075)
    theta = "joint" if rho == "joint" else "bartlett"
    facts = CaptureFacts(phase="random", delay="relative")
    with pytest.raises(ValueError, match='rho must be "none", "isq" or "lr"'):
        ChartEstimator(array, facts, theta=theta, rho=rho)
    estimator = ChartEstimator(array, facts, rho="isq")
    assert estimator.options.phase == "random"
    with pytest.raises(ValueError, match='rho must be "none", "isq" or "lr"'):
        estimator.set_method(theta, rho)
    assert ChartEstimator(array, facts, theta=theta, rho=rho, delay="absolute").options.rho == rho
