import numpy as np
import pytest

from chachart.config.settings import ArraySettings
from chachart.sources.scenario.channel import channels, make_channel
from chachart.sources.scenario.layout import place


def direct(array, position, exponent):
    """h = d^-r exp(-j 2 pi f d / c), spelled out in double precision."""
    distance = np.linalg.norm(position[:, None] - array.element_positions(), axis=2)
    numbers = range(array.subcarriers) if array.tones is None else array.tones
    frequency = array.carrier_hz + array.subcarrier_spacing_hz * np.array(numbers)
    wave = np.exp(-2j * np.pi * distance[..., None] * frequency / array.light_speed_m_s)
    return distance[..., None] ** -exponent * wave


@pytest.mark.parametrize("exponent", [1.0, 0.0, 1.7])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"light_speed_m_s": 3e8, "subcarrier_spacing_hz": 312.5e3},
        {"antennas": 5, "subcarriers": 1, "axis": "x", "carrier_hz": 28e9},
        {"tones": (-28, -26, -3, -1, 1, 2, 28), "subcarrier_spacing_hz": 312.5e3},
        {"tones": (-4, 0, 4, 8), "subcarrier_spacing_hz": 312.5e3},
        {"antennas": 130, "subcarriers": 100, "subcarrier_spacing_hz": 120e3},
    ],
)
def test_the_wave_is_the_formula(settings, exponent):
    array = ArraySettings(**settings).geometry()
    position = place("uniform", 20, array)
    expected = direct(array, position, exponent)
    got = make_channel("los", array, position, exponent=exponent).csi(np.arange(20), position)
    assert got.dtype == np.complex64
    np.testing.assert_allclose(got, expected, atol=2e-5 * np.abs(expected).max())


def test_channels_have_unit_mean_power_and_keep_their_proportions():
    array = ArraySettings(antennas=8, subcarriers=4).geometry()
    position = place("vip", 1000, array)
    csi = channels("los", position, array)
    assert np.mean(np.abs(csi) ** 2, dtype=np.float64) == pytest.approx(1.0, rel=1e-5)
    expected = direct(array, position, 1.0)
    expected /= np.sqrt(np.mean(np.abs(expected) ** 2))
    np.testing.assert_allclose(csi, expected, atol=1e-4)


def test_a_ue_on_top_of_the_array_stays_finite():
    array = ArraySettings(antennas=4, subcarriers=2).geometry()
    position = np.array([array.position_m, (50.0, 0.0, 1.5)])
    assert np.isfinite(channels("los", position, array)).all()


def test_what_is_quick_is_quiet():
    array = ArraySettings(antennas=4, subcarriers=2).geometry()
    calls = []
    channels("los", place("uniform", 10, array), array, progress=lambda *done: calls.append(done))
    assert calls == []
