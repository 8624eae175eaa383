import numpy as np
import pytest

from chachart.sources.scenario.large_scale import (
    PARAMETERS,
    QLOS,
    QNLOS,
    LargeScaleFields,
    correlation_root,
)

BOTH = pytest.mark.parametrize("statistics", [QLOS, QNLOS], ids=["qlos", "qnlos"])


def over_draws(statistics, distance=300.0, draws=40, places=100):
    """Large-scale parameters at places far from each other, over several draws of the fields."""
    position = 3000.0 * np.stack(np.divmod(np.arange(places), 10), axis=1)
    return [
        LargeScaleFields(statistics, np.random.default_rng(seed)).at(position, np.full(places, distance))
        for seed in range(draws)
    ]


@BOTH
def test_the_mixing_matrix_is_the_root_of_the_correlations(statistics):
    root = correlation_root(statistics)
    matrix = root @ root
    np.testing.assert_allclose(np.diag(matrix), 1)
    assert np.linalg.eigvalsh(matrix).min() > 0
    for (a, b), value in statistics.correlation.items():
        assert matrix[PARAMETERS.index(a), PARAMETERS.index(b)] == pytest.approx(value)
    assert np.count_nonzero(np.abs(matrix) > 1e-9) == 8 + 2 * len(statistics.correlation)


@BOTH
def test_parameters_have_the_means_deviations_and_correlations_of_the_table(statistics):
    draws = over_draws(statistics)
    a, b = statistics.path_loss_db
    rows = {
        "DS": [np.log10(d.delay_spread_s) for d in draws],
        "K": [10 * np.log10(d.rice) for d in draws],
        "SF": [10 * np.log10(d.gain) + a * np.log10(300.0) + b for d in draws],
        "AsD": [np.log10(np.rad2deg(d.azimuth_bs)) for d in draws],
        "AsA": [np.log10(np.rad2deg(d.azimuth_ue)) for d in draws],
        "EsD": [np.log10(np.rad2deg(d.elevation_bs)) for d in draws],
        "EsA": [np.log10(np.rad2deg(d.elevation_ue)) for d in draws],
        "XPR": [10 * np.log10(d.cross_polar) for d in draws],
    }
    values = np.array([np.ravel(rows[name]) for name in PARAMETERS])
    std = np.array(statistics.std)
    np.testing.assert_allclose((values.mean(axis=1) - statistics.mean) / std, 0, atol=0.07)
    np.testing.assert_allclose(values.std(axis=1) / std, 1, atol=0.05)
    wanted = correlation_root(statistics) @ correlation_root(statistics)
    np.testing.assert_allclose(np.corrcoef(values), wanted, atol=0.07)


def test_gain_falls_with_distance_by_the_path_loss_alone():
    place = np.zeros((1, 3))
    fields = LargeScaleFields(QNLOS, np.random.default_rng(0))
    near, far = (fields.at(place, np.array([d])).gain[0] for d in (100.0, 1000.0))
    assert 10 * np.log10(near / far) == pytest.approx(28.5)
