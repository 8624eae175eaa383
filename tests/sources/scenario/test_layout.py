import numpy as np
import pytest

from chachart.config.settings import ArraySettings
from chachart.sources.scenario.layout import AREA_M, LETTER_UES, place

ARRAY = ArraySettings().geometry()


@pytest.mark.parametrize("name", ["vip", "uniform", "grid"])
@pytest.mark.parametrize("ues", [1, 7, 300, 2048])
def test_every_layout_fills_its_area_at_the_height_of_the_ues(name, ues):
    position = place(name, ues, ARRAY)
    assert position.shape == (ues, 3)
    for column, (low, high) in zip(position.T, AREA_M, strict=False):
        assert low <= column.min() <= column.max() <= high
    np.testing.assert_array_equal(position[:, 2], 1.5)
    assert len(np.unique(position, axis=0)) == ues


def test_same_seed_same_places_and_letters_whatever_the_seed():
    one, again, other = (place("vip", 2048, ARRAY, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    np.testing.assert_array_equal(one[:LETTER_UES], other[:LETTER_UES])
    assert not np.any(np.all(one[LETTER_UES:] == other[LETTER_UES:], axis=1))


def test_the_letters_are_lines_denser_than_the_crowd():
    position = place("vip", 2048, ARRAY)
    step = np.linalg.norm(np.diff(position[:LETTER_UES], axis=0), axis=1)
    assert np.median(step) < 8
    assert np.sum(step > 20) == 2  # from V to I and from I to P


def test_the_rest_is_uniform():
    position = place("vip", 20000, ARRAY)[LETTER_UES:]
    for column, (low, high) in zip(position.T, AREA_M, strict=False):
        counts, _ = np.histogram(column, bins=10, range=(low, high))
        np.testing.assert_allclose(counts, len(position) / 10, rtol=0.1)


@pytest.mark.parametrize(
    ("axis", "broadside"), [("x", None), ("-y", None), ("y", "-x"), ("z", "y"), ((1, 1, 0), None)]
)
def test_the_layout_lies_before_the_array_however_it_stands(axis, broadside):
    array = ArraySettings(axis=axis, broadside=broadside, position_m=(30.0, -70.0, 25.0)).geometry()
    position = place("vip", 500, array)
    ahead = (position - array.position_m) @ np.array(array.broadside)
    assert ahead.min() >= 100 - 1e-9
    if axis != "z":
        reference = place("vip", 500, ARRAY)
        np.testing.assert_allclose(array.chart_of(position), ARRAY.chart_of(reference), atol=1e-9)
