"""The joint method and the phases of frames: steady, random, moving, found out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from paths import JOINT, WIDE, weaker_first

from chachart.node.estimation.covariance import Grouping
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.phase_watch import PhaseWatch

Build = Callable[..., Any]


def test_finding_out_that_phases_are_steady(los: Build) -> None:
    world = weaker_first(los(2, **WIDE).array, 32)
    auto, told = (ChartEstimator(world.array, **JOINT, phase=p) for p in ("auto", "steady"))
    for _ in range(12):
        block = world.block(-8.0)
        a, b = auto.update(block), told.update(block)
    assert np.array_equal(a.theta, b.theta)
    assert np.array_equal(a.rho_std, b.rho_std)


@pytest.mark.parametrize("phase", ["random", "moving"])
@pytest.mark.parametrize("at_once", [False, True])
def test_finding_out_that_phases_are_not_steady(los: Build, phase: str, at_once: bool) -> None:
    world = weaker_first(los(2, **WIDE).array, 32)
    auto, told = (ChartEstimator(world.array, **JOINT, phase=p) for p in ("auto", "random"))
    for _ in range(1 if at_once else 10):
        block = world.block(5.0, phase=phase, frames=10 if at_once else 1)
        a, b = auto.update(block), told.update(block)
    a, b = (e.update(world.block(5.0, phase=phase, frames=8)) for e in (auto, told))
    assert np.mean(np.abs(a.rho - b.rho) < 3) > 0.95
    assert np.mean(world.errors(a)[1] < 10) > 0.9
    assert a.snapshots == pytest.approx(b.snapshots)


def test_the_chart_does_not_jump_when_phases_turn_out_random(los: Build) -> None:
    world = weaker_first(los(2, **WIDE).array, 64)
    estimator = ChartEstimator(world.array, **JOINT, averaging="mean")
    for _ in range(10):
        before = estimator.update(world.block(3.0))
    charts = [estimator.update(world.block(3.0, phase="random")) for _ in range(10)]
    for chart in charts:
        assert np.mean(np.abs(chart.rho - before.rho) < 3) > 0.95
        assert np.mean(np.abs(chart.theta - before.theta) < 0.01) > 0.95
    assert charts[-1].snapshots.tolist() == [20.0] * 64


def test_ues_that_were_quiet_during_the_change_keep_what_they_had(los: Build) -> None:
    world = weaker_first(los(2, **WIDE).array, 64)
    estimator = ChartEstimator(world.array, **JOINT)
    for _ in range(8):
        before = estimator.update(world.block(0.0))
    others = np.arange(32)
    for _ in range(8):
        estimator.update(world.block(0.0, phase="random").take(others))
    after = estimator.update(world.block(0.0, phase="random"))
    assert np.mean(np.abs(after.rho - before.rho)[32:] < 5) > 0.95


def test_phase_watch_ignores_noise_and_single_frames() -> None:
    rng = np.random.default_rng(0)
    watch = PhaseWatch(1.0)
    watch.resize(8)
    noise = (rng.standard_normal((8, 16, 16, 2)) @ [1, 1j]).astype(np.complex64)
    group, steady = Grouping(np.arange(8)), np.zeros(8, np.bool_)
    for _ in range(50):
        watch.look(group, noise, noise.copy(), steady)
        other = (rng.standard_normal((8, 16, 16, 2)) @ [1, 1j]).astype(np.complex64)
        watch.look(group, noise, noise + other, steady)
    assert not watch.random(np.arange(8), steady).any()


@pytest.mark.parametrize("averaging", ["mean", "exponential"])
def test_each_ue_is_judged_by_its_own_phases_and_may_come_to_rest(los: Build, averaging: str) -> None:
    """Of 64 UEs 16 move, each frame's paths having other phases, and then stand."""
    world = weaker_first(los(2, **WIDE).array, 64)
    moving = np.arange(64) % 4 == 0
    auto, steady, random = (
        ChartEstimator(world.array, **JOINT, averaging=averaging, phase=phase)
        for phase in ("auto", "steady", "random")
    )
    for _ in range(40):
        block = world.block(0.0)
        block.csi[moving] = world.block(0.0, phase="moving").csi[moving]
        a, told, mean = (estimator.update(block) for estimator in (auto, steady, random))
    assert np.array_equal(a.rho[~moving], told.rho[~moving])
    assert np.mean(np.abs(a.rho - mean.rho)[moving] < 5) > 0.9
    assert np.mean(world.errors(a)[1][moving] < 10) > np.mean(world.errors(told)[1][moving] < 10)
    for _ in range(80):
        a, told = (estimator.update(world.block(0.0)) for estimator in (auto, steady))
    assert np.mean(world.errors(a)[1][moving] < 10) > 0.9
    fresh = ChartEstimator(world.array, **JOINT, averaging=averaging, phase="steady")
    for _ in range(16):
        told = fresh.update(world.block(0.0))
    assert np.median(a.rho_std[moving]) < 1.2 * np.median(told.rho_std[moving])  # in phase again
