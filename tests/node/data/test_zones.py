from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from chachart.node.data.zones import ZoneSettings, enclosed_m2, inside

metres = st.floats(-100, 100)
L = ((0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0))


def test_an_area_that_is_not_convex() -> None:
    zone = ZoneSettings(name="corner", polygon=L)
    x = np.array([0.5, 3.5, 0.5, 2.0, 5.0, -0.5, np.nan])
    y = np.array([0.5, 0.5, 2.9, 2.0, 0.5, 0.5, 0.5])
    assert zone.contains(x, y).tolist() == [True, True, True, False, False, False, False]
    assert enclosed_m2(zone.outline()) == pytest.approx(6.0)


def test_a_circle() -> None:
    zone = ZoneSettings(name="round", circle=(10.0, -5.0, 3.0))
    assert zone.contains(np.array([12.9, 13.1, 10.0]), np.array([-5.0, -5.0, -7.9])).tolist() == [
        True,
        False,
        True,
    ]
    assert enclosed_m2(zone.outline()) == pytest.approx(9 * np.pi, rel=0.01)


@given(
    corners=st.tuples(*[st.tuples(metres, metres)] * 3),
    weights=st.tuples(*[st.floats(0.05, 1.0)] * 3),
)
def test_a_mean_of_a_triangles_corners_is_inside(
    corners: tuple[tuple[float, float], ...], weights: tuple[float, float, float]
) -> None:
    triangle = np.array(corners)
    if enclosed_m2(triangle) < 1e-3:
        return
    x, y = np.array(weights) / np.sum(weights) @ triangle
    beyond = 2 * triangle[0] - np.array([x, y])  # the other side of a corner
    assert inside(triangle, np.array([x, beyond[0]]), np.array([y, beyond[1]])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "one of polygon and circle"),
        ({"polygon": L, "circle": (0.0, 0.0, 1.0)}, "one of polygon and circle"),
        ({"polygon": ((0.0, 0.0), (1.0, 1.0), (2.0, 2.0))}, "encloses nothing"),
        ({"circle": (0.0, 0.0, 0.0)}, "greater than 0"),
    ],
)
def test_what_is_no_zone(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        ZoneSettings.model_validate({"name": "a"} | keys)
