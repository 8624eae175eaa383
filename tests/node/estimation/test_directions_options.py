"""Arrays that are no uniform line: what else they can be told, and what does not go with them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from directions_samples import CARRIER_HZ, WAVE_M, an_array, located, some_frames, somewhere

from chachart.node.data.elements import grid
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry
from chachart.node.estimation.directions.axis import manifold_of, sub_arrays
from chachart.node.estimation.directions.sphere import fibonacci, moved, tangents, unit
from chachart.node.estimation.estimator import ChartEstimator


@pytest.mark.parametrize(
    "options", [{"signal_order": "mdl"}, {"signal_order": "threshold"}, {"signal_order": 2}]
)
def test_orders_and_symmetry_keep_the_accuracy(options: dict[str, Any]) -> None:
    for more in ({}, {"forward_backward": True}):
        found = located(an_array("2x4"), "2x4", 10.0, ues=200, theta="music", **options, **more)
        assert max(found[:2]) < 1.2


def test_smoothing_tells_coherent_echoes_apart() -> None:
    """Two echoes of one signal: a covariance of rank one, in which MUSIC alone sees no second path."""
    array = an_array("8x8", 2)
    manifold = manifold_of(array)
    d = unit(np.array([-0.3, 0.4]), np.array([0.1, -0.2]))
    h = (manifold.steering(d) * np.array([[1.0], [0.7j]])).sum(axis=0)
    csi = np.tile(h[None, :, None], (1, 1, 2)).astype(np.complex64)
    rng = np.random.default_rng(0)
    off = {}
    for smoothing in (1.0, 0.6):
        estimator = ChartEstimator(array, theta="mvdr", rho="none", smoothing=smoothing, loading=1e-3)
        for t in range(20):
            noise = 0.01 * rng.standard_normal((*csi.shape, 2), np.float32).view(np.complex64)[..., 0]
            chart = estimator.update(csi + noise, ue=[1], time_ns=[t])
        found = unit(chart["azimuth"], chart["elevation"])
        off[smoothing] = np.linalg.norm(found - d[0])
    assert off[0.6] < 0.01
    assert off[0.6] < off[1.0] / 2


def test_sub_arrays_look_alike() -> None:
    array = an_array("8x8")
    parts, sub = sub_arrays(array, 0.75)
    assert parts.shape == (9, 36)
    places = array.own_elements[parts]
    np.testing.assert_allclose(
        places - places[:, :1],
        np.broadcast_to(sub.own_elements - sub.own_elements[0], places.shape),
        atol=1e-12,
    )


def test_a_dead_element_leaves_the_others_exact() -> None:
    whole = an_array("2x4", 8)
    array = ArrayGeometry.from_dict({**whole.as_dict(), "dead_antennas": [2]})
    d = unit(np.array([0.4]), np.array([-0.3]))
    csi = some_frames(whole, d, np.array([50.0]), 100.0, np.random.default_rng(0))
    csi[:, 2] = 7
    chart = ChartEstimator(array, theta="music").update(csi, ue=[1])
    assert chart["azimuth"][0] == pytest.approx(0.4, abs=1e-4)
    assert chart["elevation"][0] == pytest.approx(-0.3, abs=1e-4)


@pytest.mark.parametrize("rho", ["bartlett", "none"])
def test_a_board_that_looks_down_charts_the_floor(rho: str) -> None:
    """By direction and range, or by direction and the plane of the UEs alone."""
    array = an_array(
        "2x4", 64, position_m=(1.0, 2.0, 4.0), axis=(0.0, 1.0, 0.0), broadside=(0.0, 0.0, -1.0), height_m=3.0
    )
    rng = np.random.default_rng(5)
    place = np.stack([rng.uniform(-2, 4, 50), rng.uniform(-1, 5, 50), np.full(50, 1.0)], axis=1)
    distance = np.linalg.norm(place - array.centre_m, axis=1)
    csi = some_frames(array, array.towards(place), distance, 60.0, rng)
    chart = ChartEstimator(array, theta="bartlett", rho=rho).update(csi, ue=np.arange(50))
    np.testing.assert_allclose(np.stack([chart.x, chart.y, chart["z"]], 1), place, atol=0.05)


def test_directions_above_the_plane_are_counted() -> None:
    array = an_array("2x4", 4, height_m=3.0)
    csi = some_frames(
        array, unit(np.zeros(2), np.array([0.3, -0.3])), np.ones(2), 60.0, np.random.default_rng(0)
    )
    estimator = ChartEstimator(array, theta="music", rho="none")
    assert estimator.update(csi, ue=[1, 2]).ue.tolist() == [2]
    assert estimator.rejected.as_dict() == {"above_plane": 1}


@pytest.mark.parametrize("rho", ["isq", "lr"])
def test_ranging_by_amplitude_needs_no_line(rho: str) -> None:
    array = an_array("uca5", 16, position_m=(0.0, 0.0, 10.0))
    rng = np.random.default_rng(6)
    place = np.stack([rng.uniform(-60, 60, 200), rng.uniform(-60, 60, 200), np.zeros(200)], axis=1)
    distance = np.linalg.norm(place - array.centre_m, axis=1)
    clean = some_frames(array, array.towards(place), distance, 60.0, rng) * (20 / distance)[:, None, None]
    chart = ChartEstimator(array, rho=rho, lr_log_range=True).update(
        clean.astype(np.complex64), ue=np.arange(200), position=place
    )
    error = np.hypot(chart.x - place[:, 0], chart.y - place[:, 1])
    assert np.median(error) < (1.5 if rho == "lr" else 15)


def test_an_uneven_line_sees_theta() -> None:
    places = np.array([[0.0, 0, 0], [0.4, 0, 0], [1.3, 0, 0], [1.9, 0, 0]]) * WAVE_M
    array = ArrayGeometry.of_elements("a", places, 16, CARRIER_HZ, 781250.0)
    assert array.is_line
    assert not array.is_uniform
    theta = np.array([0.7, 1.4, 2.2])
    d = np.stack([np.cos(theta), np.zeros(3), np.sin(theta)], axis=1)
    csi = some_frames(array, d, np.full(3, 100.0), 40.0, np.random.default_rng(0))
    chart = ChartEstimator(array, theta="music").update(csi, ue=np.arange(3))
    np.testing.assert_allclose(chart.theta, theta, atol=0.01)
    np.testing.assert_allclose(chart.y, 100 * np.cos(theta), atol=2)


def test_a_row_is_a_line() -> None:
    array = ArrayGeometry.of_elements("a", grid(1, 8, 0.05), 4, CARRIER_HZ, 1e6, position_m=(1.0, 2.0, 3.0))
    assert array.is_uniform
    np.testing.assert_allclose(array.element_positions()[:, 1], 2 + (np.arange(8) - 3.5) * 0.05)


def test_state_and_spectra_survive_a_snapshot() -> None:
    array = an_array("uca16", 8)
    d = unit(*somewhere("uca16", 4, np.random.default_rng(0)))
    csi = some_frames(array, d, np.full(4, 50.0), 20.0, np.random.default_rng(0))
    first, second = (ChartEstimator(array, theta="music") for _ in range(2))
    first.update(csi, ue=np.arange(4))
    second.restore(first.snapshot())
    np.testing.assert_array_equal(first.update(csi, ue=np.arange(4)).x, second.update(csi, ue=np.arange(4)).x)
    spectrum = second.spectrum(2)
    assert spectrum is not None
    best = spectrum["azimuth_grid_rad"][np.argmax(spectrum["azimuth_spectrum"])]
    assert best == pytest.approx(np.arctan2(d[2, 0], d[2, 2]), abs=0.02)
    assert spectrum["theta_spectrum"].max() == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("shape", "options", "says"),
    [
        ("uca5", {"forward_backward": True}, "not symmetric"),
        ("uca16", {"theta": "mvdr", "smoothing": 0.7}, "smoothing must be 1"),
        ("2x4", {"theta": "music", "signal_order": 8}, "signal_order must be below 8"),
    ],
)
def test_what_does_not_go_with_an_array_is_said(shape: str, options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        ChartEstimator(an_array(shape), **options)


def test_elements_on_a_slanting_line_have_no_direction() -> None:
    array = ArrayGeometry.of_elements("a", np.outer(np.arange(4), [0, 0.04, 0.01]), 4, CARRIER_HZ, 1e6)
    with pytest.raises(ValueError, match="axis is along that line"):
        ChartEstimator(array)


def test_steps_on_the_sphere() -> None:
    d = fibonacci(0.5)
    e = tangents(d)
    np.testing.assert_allclose(
        np.einsum("ikx,jkx->kij", e, e), np.broadcast_to(np.eye(2), (len(d), 2, 2)), atol=1e-12
    )
    np.testing.assert_allclose(np.einsum("ikx,kx->ki", e, d), 0, atol=1e-12)
    step = np.full((2, len(d)), 0.1)
    np.testing.assert_allclose((moved(d, e, step) * d).sum(1), np.cos(0.1 * np.sqrt(2)))


def test_smoothing_on_a_line_and_over_the_band() -> None:
    """One frame of two coherent paths: MVDR sees neither without smoothing, and both directions with it."""
    array = ArrayGeometry("line", 16, 16, 2e9, 1e6, SPEED_OF_LIGHT / 2e9 / 2)
    theta, rho = np.array([1.2, 1.9]), np.array([60.0, 130.0])
    n, t = np.arange(16), np.arange(16)
    waves = [
        np.exp(1j * (array.theta_phase * np.cos(a) * n[:, None] + array.rho_phase * r * t))
        for a, r in zip(theta, rho, strict=True)
    ]
    noise = np.random.default_rng(0).standard_normal((1, 16, 32)).view(np.complex128)
    csi = (waves[0] + 0.8j * waves[1] + 0.01 * noise).astype(np.complex64)
    off = {}
    for smoothing in (1.0, 0.6):
        estimator = ChartEstimator(array, theta="mvdr", rho="mvdr", smoothing=smoothing, loading=1e-3)
        chart = estimator.update(csi, ue=[1])
        off[smoothing] = abs(chart.theta[0] - theta[0]), abs(chart.rho[0] - rho[0])
    assert off[0.6][0] < 0.02
    assert off[0.6][1] < 3
    levels = ChartEstimator(array, theta="music", rho="isq", smoothing=0.6)
    assert np.isfinite(levels.update(csi, ue=[1]).rho).all()
    gaps = ArrayGeometry.from_dict({**array.as_dict(), "dead_antennas": [3]})
    with pytest.raises(ValueError, match="smoothing must be 1"):
        ChartEstimator(gaps, theta="mvdr", smoothing=0.6)


def test_a_line_tells_its_strongest_paths_too() -> None:
    array = ArrayGeometry("line", 16, 32, 2e9, 1e6, SPEED_OF_LIGHT / 2e9 / 2)
    theta, rho = np.array([1.2, 1.9]), np.array([60.0, 80.0])
    turn = array.theta_phase * array.middle_hz / array.carrier_hz
    n, t = np.arange(16)[:, None], np.arange(32)
    first, second = (
        np.exp(1j * (turn * np.cos(a) * n + array.rho_phase * r * t)) for a, r in zip(theta, rho, strict=True)
    )
    noise = np.random.default_rng(0).standard_normal((1, 16, 64)).view(np.complex128)
    estimator = ChartEstimator(array, theta="joint", rho="joint")
    estimator.update((first + 0.5j * second + 0.01 * noise).astype(np.complex64), ue=[1])
    spectrum = estimator.spectrum(1)
    assert spectrum is not None
    np.testing.assert_allclose(spectrum["path_theta"], theta, atol=0.01)
    np.testing.assert_allclose(spectrum["path_rho_m"], rho, atol=0.5)
    np.testing.assert_allclose(spectrum["path_power_db"], [0, -6.02], atol=0.3)
