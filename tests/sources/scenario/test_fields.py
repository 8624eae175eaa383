import numpy as np
import pytest

from chachart.sources.scenario.fields import GaussianFields, autocorrelation


def ensemble(distance, draws=300):
    """Values of many unit-scale fields at points that far apart, (draws, points)."""
    position = np.stack([distance, np.zeros_like(distance)], axis=1)
    return GaussianFields(np.ones(draws), np.random.default_rng(1)).at(position).T


def test_values_are_standard_normal():
    values = ensemble(np.arange(0, 1000, 10.0))
    assert values.mean() == pytest.approx(0, abs=0.02)
    assert values.var() == pytest.approx(1, abs=0.02)
    np.testing.assert_allclose(
        np.percentile(values, (2.5, 16, 84, 97.5)), (-1.96, -0.99, 0.99, 1.96), atol=0.04
    )


def test_the_autocorrelation_is_gaussian_near_and_exponential_far():
    d = np.linspace(0, 4, 41)
    assert autocorrelation(d)[[0, 5, 20]] == pytest.approx([1, np.exp(-0.25), np.exp(-2)])
    offset = np.arange(0, 600, 20.0)[:, None]
    values = ensemble((offset + d).ravel()).reshape(-1, len(offset), len(d))
    measured = np.mean(values[..., :1] * values, axis=(0, 1))
    np.testing.assert_allclose(measured, autocorrelation(d), atol=0.05)


def test_the_decorrelation_distance_stretches_the_field_and_direction_does_not_matter():
    position = np.random.default_rng(2).uniform(-5000, 5000, (4000, 2))
    fields = GaussianFields(np.array([10.0, 100.0]), np.random.default_rng(3))
    for step in (np.array([50.0, 0.0]), np.array([0.0, 50.0]), np.array([35.4, -35.4])):
        here, there = fields.at(position), fields.at(position + step)
        correlation = np.mean(here * there, axis=0) / np.mean(here**2, axis=0)
        np.testing.assert_allclose(correlation, autocorrelation([5.0, 0.5]), atol=0.12)


def test_fields_are_independent_and_height_does_not_matter():
    position = np.random.default_rng(4).uniform(-5000, 5000, (3000, 3))
    fields = GaussianFields(np.full(6, 10.0), np.random.default_rng(5))
    values = fields.at(position)
    np.testing.assert_allclose(np.corrcoef(values.T), np.eye(6), atol=0.08)
    np.testing.assert_array_equal(values, fields.at(position[:, :2]))
