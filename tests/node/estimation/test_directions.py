"""Directions of arrays that are no uniform line, against theory: ideal covariances and Cramér-Rao bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from chachart.node.data.csi import CsiBlock
from chachart.node.data.elements import circle, grid
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry
from chachart.node.estimation import spectra
from chachart.node.estimation.bounds import information_scale
from chachart.node.estimation.directions.algebra import inverse
from chachart.node.estimation.directions.axis import manifold_of, sub_arrays
from chachart.node.estimation.directions.board import BoardManifold
from chachart.node.estimation.directions.free import FreeManifold, RingManifold
from chachart.node.estimation.directions.manifold import DirectionManifold, compass
from chachart.node.estimation.directions.sphere import fibonacci, moved, tangents, unit
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.subspace import dominant

CARRIER_HZ = 3.5e9
WAVE_M = SPEED_OF_LIGHT / CARRIER_HZ
SHAPES = {
    "2x4": grid(2, 4, WAVE_M / 2),
    "8x8": grid(8, 8, WAVE_M / 2),
    "uca5": circle(5, 0.33 * WAVE_M),
    "uca16": circle(16, WAVE_M),
    "space": np.random.default_rng(7).uniform(-WAVE_M, WAVE_M, (9, 3)),
}
METHODS = {
    "bartlett": lambda r, ends: np.linalg.cholesky(r),
    "mvdr": lambda r, ends: spectra.mvdr(r, 0.05),
    "music": lambda r, ends: dominant(r, 1).conj().swapaxes(1, 2),
    "minnorm": lambda r, ends: spectra.minnorm(dominant(r, 1).conj().swapaxes(1, 2), ends),
}


def an_array(shape: str, subcarriers: int = 16, **changes: Any) -> ArrayGeometry:
    return ArrayGeometry.of_elements("a", SHAPES[shape], subcarriers, CARRIER_HZ, 781250.0, **changes)


def somewhere(shape: str, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths and elevations that the array can tell, away from the edges."""
    if shape in ("2x4", "8x8"):
        return rng.uniform(-0.8, 0.8, count), rng.uniform(-0.6, 0.6, count)
    if shape == "space":
        return rng.uniform(-3.1, 3.1, count), rng.uniform(-1.0, 1.0, count)
    return rng.uniform(-3.1, 3.1, count), rng.uniform(-1.1, -0.5, count)


def some_frames(
    array: ArrayGeometry, d: np.ndarray, rho: np.ndarray, snr_db: float, rng: np.random.Generator
) -> np.ndarray:
    """One frame a UE: a plane wave from d (K, 3) at rho (K,), with a phase of its own, in noise."""
    steering = np.exp(2j * np.pi * array.middle_hz / array.light_speed_m_s * d @ array.own_elements.T)
    delay = np.exp(1j * array.rho_phase * rho[:, None] * array.tone_numbers)
    h = steering[:, :, None] * delay[:, None] * np.exp(2j * np.pi * rng.random((len(d), 1, 1)))
    noise = rng.standard_normal((*h.shape, 2)).view(np.complex128)[..., 0]
    return (h + noise * 10 ** (-snr_db / 20) / np.sqrt(2)).astype(np.complex64)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("snr", [0.1, 1e4])
def test_exact_on_an_ideal_covariance(shape: str, method: str, snr: float) -> None:
    array = an_array(shape)
    for manifold in (manifold_of(array), FreeManifold(array)):
        d = unit(*somewhere(shape, 60, np.random.default_rng(1)))
        a = manifold.steering(d)
        r = snr * a[:, :, None] * a[:, None].conj() + np.eye(manifold.size)
        x = METHODS[method](r, manifold.corners)
        features = manifold.features(x, x.conj())
        found, _ = manifold.extremum(features, maximum=method in spectra.MAXIMUM)
        assert np.linalg.norm(found - d, axis=1).max() < 1e-6


def test_azimuth_alone_is_exact_too() -> None:
    for array in (an_array("uca5"), an_array("space")):
        manifold = RingManifold(array)
        azimuth = np.random.default_rng(2).uniform(-3.1, 3.1, 60)
        a = manifold.steering(unit(azimuth, np.zeros(60)))[:, :, None]
        found, value = manifold.extremum(manifold.features(a, a.conj()), maximum=True)
        assert np.abs(manifold.coordinates(found)["azimuth"] - azimuth).max() < 1e-6
        np.testing.assert_allclose(value, array.antennas**2, rtol=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_derivatives_are_those_of_the_spectrum(shape: str) -> None:
    array = an_array(shape)
    rng = np.random.default_rng(3)
    for manifold in (manifold_of(array), FreeManifold(array)):
        x = rng.standard_normal((20, manifold.size, 3)) + 1j * rng.standard_normal((20, manifold.size, 3))
        features = manifold.features(x, x.conj())
        d = unit(*somewhere(shape, 20, rng))
        e = manifold.ways(d)

        def value(
            s: float, t: float, m: DirectionManifold = manifold, f: Any = features, d: Any = d, e: Any = e
        ) -> Any:
            at = m.moved(d, e, np.array([np.full(20, s), np.full(20, t)]))
            return m.derivatives(f, at, m.ways(at))[0]

        f, slope, bend = manifold.derivatives(features, d, e)
        np.testing.assert_allclose(
            f, np.linalg.norm(manifold.steering(d).conj()[:, None] @ x, axis=2)[:, 0] ** 2
        )
        h = 1e-4
        np.testing.assert_allclose(slope[0], (value(h, 0) - value(-h, 0)) / (2 * h), rtol=1e-4, atol=1e-2)
        np.testing.assert_allclose(slope[1], (value(0, h) - value(0, -h)) / (2 * h), rtol=1e-4, atol=1e-2)
        cross = (value(h, h) - value(h, -h) - value(-h, h) + value(-h, -h)) / (4 * h * h)
        np.testing.assert_allclose(bend[1], cross, rtol=1e-4, atol=1)
        np.testing.assert_allclose(bend[0], (value(h, 0) - 2 * f + value(-h, 0)) / h**2, rtol=1e-4, atol=1)


def test_a_boards_lags_are_those_of_its_covariance() -> None:
    """Elements in any order; the spectrum on the grid is that of the steering vectors."""
    array = ArrayGeometry.of_elements(
        "a", SHAPES["2x4"][np.random.default_rng(0).permutation(8)], 4, CARRIER_HZ, 1e6
    )
    manifold = manifold_of(array)
    assert isinstance(manifold, BoardManifold)
    x = np.random.default_rng(1).standard_normal((5, 8, 6)).view(np.complex128)
    features = manifold.features(x, x.conj())
    expected = np.linalg.norm(manifold.steering(manifold.points).conj()[None] @ x, axis=2) ** 2
    np.testing.assert_allclose(manifold.spectrum(features), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(manifold.trace(features), np.linalg.norm(x, axis=(1, 2)) ** 2)


def located(
    array: ArrayGeometry, shape: str, snr_db: float, ues: int = 500, frames: int = 10, **options: Any
):
    """Errors over the bound and over what is stated, in azimuth and elevation: root mean squares."""
    rng = np.random.default_rng(round(snr_db) + 100)
    azimuth, elevation = somewhere(shape, ues, rng)
    d, rho = unit(azimuth, elevation), rng.uniform(20, 300, ues)
    estimator = ChartEstimator(array, averaging="mean", **options)
    for t in range(frames):
        csi = some_frames(array, d, rho, snr_db, rng)
        chart = estimator.update(CsiBlock("a", t, np.arange(ues, dtype=np.uint64), np.full(ues, t), csi))
    manifold = manifold_of(array)
    scale = information_scale(manifold.size, frames * array.subcarriers, 10 ** (snr_db / 10))
    across, _, upwards = inverse(scale * manifold.information(d, np.stack(compass(d))))
    off = np.angle(np.exp(1j * (chart["azimuth"] - azimuth))), chart["elevation"] - elevation
    bound = np.sqrt(across) / np.cos(elevation), np.sqrt(upwards)
    stated = chart["azimuth_std"], chart["elevation_std"]
    theta_off = (chart.theta - np.arccos(d[:, 0])) / chart.theta_std
    rms = [
        float(np.sqrt(np.mean((e / b) ** 2))) for e, b in zip((*off, *off), (*bound, *stated), strict=True)
    ]
    return (*rms, float(np.sqrt(np.mean(theta_off**2))), chart)


@pytest.mark.parametrize("snr_db", [-10.0, 0.0, 20.0])
@pytest.mark.parametrize("method", ["bartlett", "music"])
@pytest.mark.parametrize("shape", SHAPES)
def test_reaches_the_bound(shape: str, method: str, snr_db: float) -> None:
    """Up to what 500 UEs can tell: three standard deviations of a root mean square are 10 %."""
    array = an_array(shape, 32 if snr_db < 0 else 8)
    azimuth, elevation, *stated, theta, _ = located(
        array, shape, snr_db, frames=20 if snr_db < 0 else 4, theta=method, rho="bartlett"
    )
    assert max(azimuth, elevation) < 1.1
    assert min(*stated, theta) > 0.85
    assert max(*stated, theta) < 1.15


@pytest.mark.parametrize("snr_db", [-10.0, 0.0, 20.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_joint_reaches_the_bound(shape: str, snr_db: float) -> None:
    array = an_array(shape, 32 if snr_db < 0 else 16)
    azimuth, elevation, *stated, theta, chart = located(
        array, shape, snr_db, frames=20 if snr_db < 0 else 4, theta="joint", rho="joint"
    )
    assert max(azimuth, elevation) < 1.1
    assert min(*stated, theta) > 0.85
    assert max(*stated, theta) < 1.2
    assert (chart["delay_spread"] < 1e-6).all()


def test_two_paths_within_a_cell_come_apart() -> None:
    """0.6 of a cell in angle and in delay; also as part of the estimate, whose bias falls."""
    array = an_array("8x8", 64)
    d = unit(np.array([0.20, 0.34]), np.array([0.10, 0.05]))
    rho = np.array([60.0, 63.5])
    rng = np.random.default_rng(3)
    clean = some_frames(array, d, rho, 200.0, np.random.default_rng(0))
    csi = (clean[:1] + 0.6 * clean[1:]).astype(np.complex64)
    csi = csi + 0.1 * rng.standard_normal((*csi.shape, 2), np.float32).view(np.complex64)[..., 0]
    off = {}
    for paths in (1, 2):
        estimator = ChartEstimator(array, theta="joint", rho="joint", paths=paths)
        chart = estimator.update(csi, ue=[1])
        off[paths] = np.linalg.norm(unit(chart["azimuth"], chart["elevation"])[0] - d[0])
    assert off[2] < 0.003
    assert off[2] < off[1] / 3
    spectrum = estimator.spectrum(1)
    assert spectrum is not None
    np.testing.assert_allclose(spectrum["path_azimuth"], [0.20, 0.34], atol=0.01)
    np.testing.assert_allclose(spectrum["path_elevation"], [0.10, 0.05], atol=0.01)
    np.testing.assert_allclose(spectrum["path_rho_m"], rho, atol=0.3)
    np.testing.assert_allclose(spectrum["path_power_db"], [0, 20 * np.log10(0.6)], atol=0.5)


@pytest.mark.parametrize("phase", ["auto", "steady", "random"])
def test_joint_averages_frames_whatever_their_phase(phase: str) -> None:
    """Eight frames of one UE; with phase = "steady" they do keep it."""
    array = an_array("2x4", 16)
    rng = np.random.default_rng(8)
    azimuth, elevation = somewhere("2x4", 200, rng)
    d, rho = unit(azimuth, elevation), rng.uniform(20, 300, 200)
    still = some_frames(array, d, rho, 200.0, rng)
    estimator = ChartEstimator(array, theta="joint", rho="joint", phase=phase, averaging="mean")
    for _ in range(8):
        noise = rng.standard_normal((*still.shape, 2), np.float32).view(np.complex64)[..., 0] / np.float32(
            2**0.5
        )
        turn = np.exp(2j * np.pi * rng.random((200, 1, 1)) * (phase != "steady")).astype(np.complex64)
        chart = estimator.update(still * turn + noise, ue=np.arange(200))
    off = chart["azimuth"] - azimuth
    assert np.sqrt(np.mean((off / chart["azimuth_std"]) ** 2)) < 1.2
    assert np.median(chart["azimuth_std"]) < 0.02
    assert np.median(chart["snr"]) == pytest.approx(0, abs=0.5)


@pytest.mark.parametrize("method", ["mvdr", "minnorm"])
@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_stated_is_true(shape: str, method: str) -> None:
    *_, azimuth, elevation, theta, _ = located(an_array(shape), shape, 10.0, theta=method)
    assert min(azimuth, elevation, theta) > 0.85
    assert max(azimuth, elevation, theta) < 1.15


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
