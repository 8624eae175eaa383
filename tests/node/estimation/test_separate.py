"""One coordinate without the other: one antenna, one tone, directions alone, delays that are no distances."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator

Build = Callable[..., Any]


def test_one_antenna_charts_distances(los: Build) -> None:
    world = los(64, antennas=1, subcarrier_spacing_hz=312.5e3)
    at = world.chart(ChartEstimator(world.array, theta="none", rho="bartlett", averaging="mean"), 20.0)
    rho = world.array.theta_rho(world.position)[1]
    assert np.median(np.abs(at.rho - rho)) < 1.0
    assert (at.theta == np.pi / 2).all()
    assert at.theta_std == pytest.approx(np.pi / np.sqrt(12))
    assert at.x == pytest.approx(at.rho)
    assert np.isfinite(at.snr).all()


@pytest.mark.parametrize(("antennas", "subcarriers"), [(1, 16), (1, 1), (8, 1)])
def test_amplitude_needs_neither_antennas_nor_tones(los: Build, antennas: int, subcarriers: int) -> None:
    world = los(64, antennas=antennas, subcarriers=subcarriers, subcarrier_spacing_hz=312.5e3)
    theta: Any = "none" if antennas == 1 else "bartlett"
    at = world.chart(ChartEstimator(world.array, theta=theta, rho="isq", averaging="mean"), 30.0)
    rho = world.array.theta_rho(world.position)[1]
    assert np.corrcoef(np.argsort(np.argsort(at.rho)), np.argsort(np.argsort(rho)))[0, 1] > 0.99


@pytest.mark.parametrize("height_m", [None, 8.5])
def test_directions_alone_lie_on_a_circle(los: Build, height_m: float | None) -> None:
    world = los(64, height_m=height_m)
    estimator = ChartEstimator(world.array, theta="music", rho="none", delay="relative")
    at = world.chart(estimator, 10.0)
    theta = world.array.theta_rho(world.position)[0]
    assert np.median(np.abs(at.theta - theta)) < 0.01
    assert np.hypot(at.x, at.y) == pytest.approx(1)
    assert np.isnan(at.rho_std).all()
    assert set(estimator.spectrum(3) or {}) >= {"theta_spectrum"}


@pytest.mark.parametrize(
    ("changes", "options", "says"),
    [
        ({}, {"rho": "bartlett", "delay": "relative"}, '^rho must be "none", "isq" or "lr": bartlett takes'),
        ({}, {"theta": "joint", "rho": "joint", "delay": "relative"}, '^rho must be "none", "isq" or "lr"'),
        ({"antennas": 1}, {"theta": "music"}, '^theta must be "none": one antenna'),
        ({"subcarriers": 1}, {"rho": "mvdr"}, '^rho must be "isq", "lr" or "none": with 1 subcarrier'),
        ({}, {"theta": "none", "rho": "none"}, '^rho must not be "none" as theta is'),
        (
            {"dead_antennas": (1,)},
            {"forward_backward": True},
            "^forward_backward must be off: these antennas",
        ),
        ({"dead_tones": tuple(range(1, 32))}, {}, '^rho must be "isq", "lr" or "none"'),
        (
            {"tones": (*range(16), *range(130, 146))},
            {"theta": "joint", "rho": "joint"},
            "side lobes of these",
        ),
    ],
)
def test_what_does_not_go_together_says_what_does(
    array: ArrayGeometry, changes: dict[str, Any], options: dict[str, Any], says: str
) -> None:
    other = ArrayGeometry.from_dict(array.as_dict() | changes)
    with pytest.raises(ValueError, match=says):
        ChartEstimator(other, **options)


@pytest.mark.parametrize("amplitude", ["debiased", "coherent", "noisy"])
def test_dead_antennas_do_not_change_the_scale(los: Build, amplitude: Any) -> None:
    """The reference of ISQ holds for the whole array."""
    whole, part = los(64), los(64, dead_antennas=(0, 7, 8, 9))
    reach = [
        world.chart(
            ChartEstimator(world.array, rho="isq", amplitude=amplitude, isq_reference=(100.0, 30.0)),
            30.0,
            phase=False,
        ).rho
        for world in (whole, part)
    ]
    assert reach[1] == pytest.approx(reach[0], rel=0.02)
