from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.estimation.similarity import best_fit, errors_as_they_are, figures, in_degrees

TRUTH = np.random.default_rng(3).uniform(-100, 100, (50, 2))


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    return points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


@given(
    st.floats(-3.1, 3.1),
    st.booleans(),
    st.floats(0.1, 10),
    st.tuples(st.floats(-900, 900), st.floats(-900, 900)),
)
def test_the_fit_that_was_undone_is_found(
    angle: float, mirrored: bool, scale: float, shift: tuple[float, float]
) -> None:
    # truth = scale * R(angle) M chart + shift, so chart = M R(-angle) (truth - shift) / scale.
    chart = turned((TRUTH - shift) / scale, -angle) * ([1, -1] if mirrored else [1, 1])
    fit = best_fit(TRUTH, chart)
    assert fit.errors_m.max() < 1e-6
    assert fit.mirrored == mirrored
    assert fit.scale == pytest.approx(scale)
    assert np.exp(1j * fit.turn_rad) == pytest.approx(np.exp(1j * angle))
    assert fit.shift_m == pytest.approx(shift, abs=1e-6)


def test_a_chart_in_the_wrong_place_is_wrong_although_it_fits() -> None:
    found = figures(TRUTH, TRUTH + np.array([900, 240]))
    assert found["error_m"] == pytest.approx(np.hypot(900, 240))
    assert found["fit_error_m"] < 1e-9
    assert found["warnings"] == []
    assert (found["fit_shift_x_m"], found["fit_shift_y_m"]) == pytest.approx((-900, -240))


def test_what_a_fit_hides_is_told() -> None:
    mirrored, scaled = figures(TRUTH, TRUTH * [1, -1])["warnings"], figures(TRUTH, TRUTH * 1.2)["warnings"]
    assert len(mirrored) == len(scaled) == 1
    assert "mirrors" in mirrored[0]
    assert "scales the chart by 0.833" in scaled[0]
    assert figures(TRUTH, TRUTH * 1.05)["warnings"] == []


def test_a_chart_of_one_point() -> None:
    fit = best_fit(TRUTH, np.zeros_like(TRUTH))
    assert fit.errors_m == pytest.approx(np.linalg.norm(TRUTH - TRUTH.mean(axis=0), axis=1))


@pytest.mark.parametrize("measure", [best_fit, errors_as_they_are])
def test_points_that_do_not_go_together(measure: object) -> None:
    for truth, chart in ((TRUTH, TRUTH[1:]), (TRUTH, TRUTH * np.nan), (TRUTH[:0], TRUTH[:0])):
        with pytest.raises(ValueError, match="must be"):
            measure(truth, chart)  # type: ignore[operator]


def test_degrees_are_told_from_metres() -> None:
    places = 48.78 + np.random.default_rng(1).uniform(0, 1e-3, (20, 3))
    assert in_degrees(places)
    assert not in_degrees(places * 1000)
    assert not in_degrees(np.tile(places[:1], (20, 1))), "one place alone"
    assert not in_degrees((places - 48.78) * 10), "a table top about the origin"
