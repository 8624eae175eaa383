import numpy as np
import pytest

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation import calibrate

N = 32
ARRAY = ArrayGeometry("lab", N, 4, 2e9, 1e6, 0.0749481145, (0.0, 0.0, 10.0))


def test_the_coherent_mean_does_not_mind_the_phase_of_a_frame():
    rng = np.random.default_rng(1)
    true = rng.standard_normal((5, 3)) + 1j * rng.standard_normal((5, 3))
    frames = true * np.exp(2j * np.pi * rng.random(40))[:, None, None]
    frames = frames + 0.1 * rng.standard_normal(frames.shape)
    mean = calibrate.coherent_mean(frames)
    mean *= np.exp(-1j * np.angle(np.vdot(true, mean)))
    np.testing.assert_allclose(mean, true, atol=0.06)


@pytest.mark.parametrize("cosine", np.linspace(-1, 1, 9))
def test_the_best_plane_wave_is_found(cosine):
    wave = np.exp(1j * ARRAY.theta_phase * cosine * np.arange(N))[None]
    fitted = calibrate.plane_waves(ARRAY, wave)
    common = np.vdot(fitted, wave) / N
    np.testing.assert_allclose(fitted * common, wave, atol=0.02)


def test_a_spherical_wave_is_what_the_distances_say():
    position = np.array([[30.0, -20.0, 1.5]])
    wave = calibrate.spherical(ARRAY, position)
    distance = np.linalg.norm(ARRAY.element_positions() - position, axis=1)
    np.testing.assert_allclose(np.abs(wave[0]), 1 / np.tile(distance[:, None], 4))
    step = np.angle(wave[0, 0, 1:] * wave[0, 0, :-1].conj())
    expected = -2 * np.pi * 1e6 * distance[0] / ARRAY.light_speed_m_s
    np.testing.assert_allclose(step, np.angle(np.exp(1j * expected)), atol=1e-6)


def test_responses_are_found_exactly_without_noise():
    rng = np.random.default_rng(2)
    position = rng.uniform((50, -100, 0), (200, 100, 2), (5, 3))
    expected = calibrate.spherical(ARRAY, position)
    antenna = rng.uniform(0.5, 2, N) * np.exp(2j * np.pi * rng.random(N))
    subcarrier = rng.uniform(0.5, 2, 4) * np.exp(2j * np.pi * rng.random(4))
    order = tuple(rng.permutation(N).tolist())
    measured = np.empty_like(expected)
    measured[:, list(order)] = expected * antenna[:, None] * subcarrier
    corrected = calibrate.responses(measured, expected, order).apply(measured)
    ratio = corrected / expected
    np.testing.assert_allclose(ratio / ratio[:, :1, :1], 1.0, atol=1e-5)
    assert np.abs(ratio).mean() == pytest.approx(np.abs(antenna).mean() * np.abs(subcarrier).mean(), rel=1e-5)


@pytest.mark.parametrize("known", [True, False])
def test_the_order_is_found_whatever_the_phases(known):
    rng = np.random.default_rng(3)
    position = rng.uniform((100, -400, 0), (600, 400, 2), (30, 3))
    waves = calibrate.spherical(ARRAY, position)[:, :, 0]
    order = np.arange(N)
    order[[2, 3, 20]] = order[[3, 20, 2]]
    order[[8, 30]] = order[[30, 8]]
    measured = np.empty_like(waves)
    measured[:, order] = waves * np.exp(2j * np.pi * rng.random(N))
    phasors = measured[1:] * measured[0].conj()
    phasors = phasors / np.abs(phasors) * np.exp(0.2j * rng.standard_normal(phasors.shape))
    reference = waves[0] / np.abs(waves[0])
    places = position[1:] if known else np.full((29, 3), np.nan)
    found = calibrate.find_order(ARRAY, phasors, reference, places)
    assert found == tuple(order.tolist())
    assert sorted(map(sorted, calibrate.cycles(found))) == [[2, 3, 20], [8, 30]]


def suspected(rng: np.random.Generator, swapped: bool) -> tuple[list[tuple[int, ...]], tuple[int, int]]:
    """What one place says of an array with phase errors of 30 deg, and which pair is swapped there."""
    u = rng.uniform(-3, 3)
    wave = np.exp(1j * u * np.arange(N))
    apart = int(np.argmax(np.abs(np.angle(np.exp(1j * u * np.arange(1, N - 1)))))) + 1
    i = int(rng.integers(0, N - apart))
    measured = wave.copy()
    if swapped:
        measured[[i, i + apart]] = measured[[i + apart, i]]
    measured = measured * np.exp(1j * np.radians(30) * rng.standard_normal(N))
    error = measured[None, :] * wave.conj()[:, None]
    error *= np.exp(-1j * np.angle(np.trace(error)))
    order = calibrate.suspect_order(np.angle(np.diag(error)), np.angle(error))
    return calibrate.cycles(order), (i, i + apart)


def test_one_place_names_a_swap_of_opposite_phases_nine_times_of_ten_and_seldom_one_that_is_not_there():
    rng = np.random.default_rng(4)
    hits = sum(found == [pair] for found, pair in (suspected(rng, swapped=True) for _ in range(100)))
    alarms = sum(bool(found) for found, _ in (suspected(rng, swapped=False) for _ in range(100)))
    assert hits >= 85
    assert alarms <= 4


def test_deviations_point_at_the_antenna_that_is_off():
    rng = np.random.default_rng(5)
    u = rng.uniform(-3, 3, 20)[:, None]
    phasors = np.exp(1j * u * np.arange(N))
    phasors[:, 11] *= np.exp(0.8j)
    off = calibrate.deviations(ARRAY, phasors, np.full((20, 3), np.nan))
    assert off.argmax() == 11
    assert off[11] == pytest.approx(0.8, abs=0.05)
    assert np.delete(off, 11).max() < 0.1
