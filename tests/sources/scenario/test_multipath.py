import dataclasses

import numpy as np
import pytest
from scipy.stats import ks_2samp

from chachart.config.settings import ArraySettings
from chachart.node.data.elements import grid
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.sources.scenario import multipath
from chachart.sources.scenario.channel import channels, make_channel
from chachart.sources.scenario.large_scale import QLOS, QNLOS
from chachart.sources.scenario.layout import place
from chachart.sources.scenario.los import LosChannel
from chachart.sources.scenario.multipath import MultipathChannel

ARRAY = ArraySettings().geometry()
SEEDS = range(5)
NAMES = pytest.mark.parametrize("name", ["qlos", "qnlos"])

# 10, 50 and 90 % over UEs of channels made by the real simulator
FIGURES = {
    "qlos": {
        "amplitude variation": (0.19, 0.33, 0.48),
        "theta error": (0.05, 0.32, 1.13),
        "participation": (1.42, 2.36, 4.21),
        "direct power": (0.54, 0.77, 0.90),
        "rho error": (None, 0.74, 2.7),
    },
    "qnlos": {
        "amplitude variation": (0.32, 0.45, 0.58),
        "theta error": (0.19, 1.26, 7.9),
        "participation": (2.30, 4.28, 7.01),
        "direct power": (0.08, 0.37, 0.69),
        "rho error": (None, 4.6, 67.0),
    },
}
# how far the mean of five draws may be off, relatively: draws differ through the large-scale fields
TOLERANCE = {
    "amplitude variation": 0.1,
    "theta error": 0.2,
    "participation": 0.08,
    "direct power": 0.25,
    "rho error": 0.35,
}
# largest distance between distributions, median over five draws; a wrong model is beyond it by far
KS_LIMIT = 0.09


@pytest.fixture(scope="module")
def simulated(wide_array, figures):
    """Function: name -> figures of five draws of 2048 UEs."""
    known = {}

    def get(name):
        if name not in known:
            position = place("vip", 2048, wide_array)
            known[name] = [
                figures(channels(name, position, wide_array, seed), wide_array, position) for seed in SEEDS
            ]
        return known[name]

    return get


@NAMES
def test_statistics_are_those_of_the_real_simulator(name, simulated):
    for figure, wanted in FIGURES[name].items():
        measured = np.mean([np.percentile(draw[figure], (10, 50, 90)) for draw in simulated(name)], axis=0)
        for value, want in zip(measured, wanted, strict=True):
            if want is not None:
                assert value == pytest.approx(want, rel=TOLERANCE[figure]), figure


@NAMES
def test_distributions_are_those_of_the_real_simulators_channels(
    name, simulated, figures, wide_array, real_channels
):
    real = figures(*real_channels(name)[:1], wide_array, real_channels(name)[1])
    for figure, values in real.items():
        distance = [ks_2samp(draw[figure], values).statistic for draw in simulated(name)]
        assert np.median(distance) < KS_LIMIT, figure


def test_the_limit_on_distributions_tells_models_apart(simulated, figures, wide_array, real_channels):
    csi, position = real_channels("qnlos")
    for figure, values in figures(csi, wide_array, position).items():
        distance = [ks_2samp(draw[figure], values).statistic for draw in simulated("qlos")]
        assert np.median(distance) > 2 * KS_LIMIT, figure


def test_one_wave_a_cluster_would_not_do(monkeypatch, simulated, figures, wide_array):
    monkeypatch.setattr(multipath, "OFFSETS", np.zeros(20))
    position = place("vip", 2048, wide_array)
    narrow = figures(channels("qnlos", position, wide_array, 0), wide_array, position)
    distance = [
        ks_2samp(a, narrow["participation"]).statistic
        for a in (d["participation"] for d in simulated("qnlos"))
    ]
    assert np.median(distance) > KS_LIMIT


@NAMES
@pytest.mark.parametrize(
    "settings",
    [
        {"antennas": 2, "subcarriers": 1},
        {"antennas": 70, "subcarriers": 9, "subcarrier_spacing_hz": 1e6, "axis": "x"},
        {"antennas": 8, "subcarriers": 100, "carrier_hz": 28e9, "axis": "z", "light_speed_m_s": 3e8},
    ],
)
def test_any_array_and_bandwidth_with_unit_mean_power(name, settings):
    array = ArraySettings(**settings).geometry()
    position = place("uniform", 150, array)
    csi = channels(name, position, array, seed=1)
    assert csi.shape == (150, array.antennas, array.subcarriers)
    assert csi.dtype == np.complex64
    assert csi.flags.c_contiguous
    assert np.mean(np.abs(csi) ** 2, dtype=np.float64) == pytest.approx(1, rel=1e-5)
    np.testing.assert_array_equal(csi, channels(name, position, array, seed=1))
    assert not np.allclose(csi, channels(name, position, array, seed=2))


def test_without_clusters_it_is_the_spherical_wave():
    direct_only = dataclasses.replace(QLOS, mean=(*QLOS.mean[:1], 150.0, *QLOS.mean[2:]))
    position = place("uniform", 40, ARRAY)
    csi = MultipathChannel(direct_only, ARRAY, position).csi(np.arange(40), position)
    csi /= np.abs(csi).mean(axis=(1, 2), keepdims=True)
    wave = LosChannel(ARRAY, exponent=0.0).csi(np.arange(40), position)
    np.testing.assert_allclose(csi, wave, atol=1e-4)


def test_power_follows_path_loss_and_shadow_fading():
    array = ArraySettings(antennas=8, subcarriers=4, subcarrier_spacing_hz=2.5e6).geometry()
    position = place("uniform", 1000, array)
    for name, statistics in (("qlos", QLOS), ("qnlos", QNLOS)):
        slope, scatter = [], []
        for seed in SEEDS:
            power = np.mean(np.abs(channels(name, position, array, seed)) ** 2, axis=(1, 2))
            decades = np.log10(np.linalg.norm(position - array.position_m, axis=1))
            line = np.polyfit(decades, 10 * np.log10(power), 1)
            slope.append(line[0])
            scatter.append(np.std(10 * np.log10(power) - np.polyval(line, decades)))
        assert np.mean(slope) == pytest.approx(-statistics.path_loss_db[0], abs=8)
        assert 2.5 < np.mean(scatter) < 6


def test_a_ues_channel_does_not_depend_on_its_company():
    position = place("vip", 300, ARRAY)
    channel = make_channel("qnlos", ARRAY, position, seed=3)
    together = channel.csi(np.arange(300), position)
    some = np.array([7, 250, 7, 31])
    np.testing.assert_allclose(channel.csi(some, position[some]), together[some], rtol=1e-4, atol=1e-9)


def coherence(a, b):
    """Correlation coefficient (K,) of channels (K, N_R, N_S)."""
    product = np.abs(np.sum(a * b.conj(), axis=(1, 2)))
    return product / np.sqrt(np.sum(np.abs(a) ** 2, axis=(1, 2)) * np.sum(np.abs(b) ** 2, axis=(1, 2)))


@NAMES
def test_moving_ues_are_coherent_over_a_fraction_of_a_wavelength_and_fade_over_half_of_one(name):
    start = place("uniform", 200, ARRAY)
    channel, ue = make_channel(name, ARRAY, start), np.arange(200)
    here = start + np.array([12.0, -20.0, 0.0])
    before = channel.csi(ue, here)
    way = ARRAY.wavelength_m * np.array([0.6, 0.8, 0.0])
    near, half = (channel.csi(ue, here + part * way) for part in (0.01, 0.5))
    assert np.median(coherence(before, near)) > 0.999
    if name == "qnlos":
        assert np.median(coherence(before, half)) < 0.8


def test_large_scale_fields_follow_a_moving_ue():
    start = place("uniform", 300, ARRAY)
    channel, ue = make_channel("qlos", ARRAY, start), np.arange(300)

    def local_power(centre):
        """dB, averaged over a few wavelengths to take fast fading out."""
        wiggle = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3)) * [1, 1, 0]
        return 10 * np.log10(
            np.mean([np.mean(np.abs(channel.csi(ue, centre + w)) ** 2, (1, 2)) for w in wiggle], 0)
        )

    begin = local_power(start)
    change = [np.std(local_power(start + np.array([0.0, step, 0.0])) - begin) for step in (5.0, 40.0, 300.0)]
    assert change[0] < 2 < change[1] < change[2]


def test_a_ue_that_returns_finds_its_channel_again():
    start = place("uniform", 50, ARRAY)
    channel, ue = make_channel("qnlos", ARRAY, start), np.arange(50)
    before = channel.csi(ue, start)
    channel.csi(ue, start + np.array([30.0, 40.0, 0.0]))
    np.testing.assert_array_equal(before, channel.csi(ue, start))


def test_slow_channels_report_progress(monkeypatch):
    from chachart.sources.scenario import channel

    monkeypatch.setattr(channel, "_QUIET_S", 0.0)
    calls = []
    channels("qnlos", place("uniform", 300, ARRAY), ARRAY, progress=lambda *done: calls.append(done))
    assert calls[-1] == (300, 300)
    assert calls == sorted(calls)
    assert len(calls) > 2


def test_more_ues_than_memory_holds_are_refused():
    with pytest.raises(SetupError, match="at most 50000"):
        make_channel("qlos", ARRAY, np.zeros((50_001, 3)))


@NAMES
def test_elements_listed_one_by_one_hear_what_a_line_hears(name):
    """The same line, once as such and once as elements anywhere, which are summed up another way."""
    line = ArraySettings(antennas=6, subcarriers=4, subcarrier_spacing_hz=1e6).geometry()
    order = [0, 5, 4, 3, 2, 1]  # so that it is not taken for a line
    listed = ArrayGeometry.of_elements(
        "a",
        line.own_elements[order],
        4,
        line.carrier_hz,
        1e6,
        position_m=tuple(line.centre_m),
        axis=line.axis,
    )
    position = place("uniform", 30, line)
    np.testing.assert_allclose(
        channels(name, position, listed, seed=2), channels(name, position, line, seed=2)[:, order], atol=2e-3
    )


@NAMES
def test_a_board_sees_elevations(name):
    """UEs above and below: the strongest beam is where the UE is, within what scattering does."""
    array = ArrayGeometry.of_elements(
        "board", grid(4, 4, 0.075), 8, 2e9, 1e6, position_m=(0.0, 0.0, 20.0), axis=(0.0, 1.0, 0.0)
    )
    area = ((20.0, 60.0), (-20.0, 20.0))
    position = place("uniform", 300, array, area=area, highest_m=40.0)
    assert np.ptp(position[:, 2]) > 35
    csi = channels(name, position, array)
    chart = ChartEstimator(array, theta="bartlett").update(csi, ue=np.arange(300))
    truth = np.arcsin(array.towards(position)[:, 1])
    assert np.median(np.abs(chart["elevation"] - truth)) < (0.06 if name == "qlos" else 0.2)
    assert np.corrcoef(chart["elevation"], truth)[0, 1] > (0.9 if name == "qlos" else 0.5)
