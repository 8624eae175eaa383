from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from csi_samples import small_array
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.data.elements import circle, grid
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry

metres = st.floats(-1e4, 1e4)


def tones(count: int) -> st.SearchStrategy[tuple[int, ...]]:
    """`count` ascending numbers."""
    steps = st.lists(st.integers(1, 9), min_size=count, max_size=count)
    return steps.map(lambda s: tuple(np.cumsum(s).tolist()))


@st.composite
def arrays(draw: st.DrawFn) -> ArrayGeometry:
    """Arrays of any position and direction."""
    azimuth, elevation, turn = (draw(st.floats(-math.pi, math.pi)) for _ in range(3))
    axis = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    side = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    subcarriers = draw(st.integers(1, 64))
    broadside = np.cos(turn) * side + np.sin(turn) * np.cross(axis, side)
    return small_array(
        antennas=draw(st.integers(1, 128)),
        subcarriers=subcarriers,
        carrier_hz=draw(st.floats(1e6, 1e11)),
        position_m=draw(st.tuples(metres, metres, metres)),
        axis=tuple(axis.tolist()),
        broadside=tuple(broadside.tolist()),
        height_m=draw(st.none() | st.floats(0, 100)),
        tones=draw(st.none() | tones(subcarriers)),
        dead_tones=tuple(sorted(draw(st.sets(st.integers(1, subcarriers - 1))))) if subcarriers > 1 else (),
        light_speed_m_s=draw(st.sampled_from([SPEED_OF_LIGHT, 3e8])),
    )


@given(arrays())
def test_json_round_trip(array: ArrayGeometry) -> None:
    assert ArrayGeometry.from_dict(json.loads(json.dumps(array.as_dict()))) == array


@given(arrays(), metres, metres)
def test_theta_rho_and_chart_agree_in_the_plane_of_the_chart(
    array: ArrayGeometry, x: float, y: float
) -> None:
    """A point in front of the array, on the plane of axis and broadside, is charted where it is."""
    array = ArrayGeometry.from_dict({**array.as_dict(), "height_m": None})
    point = array.centre_m + abs(x) * np.array(array.broadside) + y * np.array(array.axis)
    theta, rho = array.theta_rho(point)
    chart = np.array(array.chart_xy(theta, rho))
    # arccos near the axis turns an error of 1e-16 in the cosine into one of 1e-8 in the angle.
    tolerance = 1e-6 * (1 + np.hypot(x, y)) + 1e-3 * (np.hypot(x, y) < 1e-3)
    np.testing.assert_allclose(chart, [abs(x), y], atol=tolerance)
    np.testing.assert_allclose(array.chart_of(point), [abs(x), y], atol=1e-8 * (1 + np.hypot(x, y)) + 1e-10)


def test_theta_grows_from_the_axis() -> None:
    array = small_array()
    around = np.array([[0, 5, 0], [5, 0, 0], [0, -5, 0], [0, 0, 0]])
    theta, rho = array.theta_rho(array.centre_m + around)
    np.testing.assert_allclose(theta, [0, math.pi / 2, math.pi, math.pi / 2])
    np.testing.assert_allclose(rho, [5, 5, 5, 0])


def test_the_height_projects_to_the_ground() -> None:
    array = small_array(position_m=(0.0, 0.0, 10.0), height_m=8.5)
    point = array.centre_m + np.array([120.0, -50.0, -8.5])
    x, y = array.chart_xy(*array.theta_rho(point))
    np.testing.assert_allclose([x, y], [120, -50])
    x, y = array.chart_xy(np.array(1.5), np.array(3.0))
    assert x == 0.0


def test_elements_stand_along_the_axis() -> None:
    array = small_array(position_m=(1.0, 2.0, 3.0), element_spacing_m=0.5)
    np.testing.assert_allclose(array.element_positions(), [[1, 2 + 0.5 * n, 3] for n in range(4)])


def test_phases_and_ranges() -> None:
    array = small_array(element_spacing_m=SPEED_OF_LIGHT / 2e9 / 2)
    assert array.wavelength_m == pytest.approx(0.149896229)
    assert array.theta_phase == pytest.approx(math.pi)
    assert array.unambiguous_rho_m == pytest.approx(959.3358656)
    assert array.rho_phase * array.unambiguous_rho_m == pytest.approx(-2 * math.pi)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"name": ""}, "name must be a text"),
        ({"antennas": 0}, "antennas must be a positive whole number"),
        ({"subcarriers": 4.0}, "subcarriers must be a positive whole number"),
        ({"carrier_hz": math.nan}, "carrier_hz must be positive"),
        ({"carrier_hz": math.inf}, "carrier_hz must be positive"),
        ({"height_m": -1.0}, "height_m must be at least 0"),
        ({"position_m": (0.0, 1.0)}, "position_m must be 3 numbers"),
        ({"position_m": (0.0, 1.0, math.nan)}, "position_m must be 3 numbers"),
        ({"subcarrier_spacing_hz": math.inf}, "subcarrier_spacing_hz must be positive"),
        ({"element_spacing_m": -1.0}, "element_spacing_m must be positive"),
        ({"axis": (0.0, 2.0, 0.0)}, "axis must be a unit vector"),
        ({"axis": (0.0, 0.0, 1e200)}, "axis must be a unit vector"),
        ({"axis": (0.0, 1.0)}, "axis must be a unit vector of 3"),
        ({"broadside": (0.0, 1.0, 0.0)}, "orthogonal"),
        ({"tones": (0, 1)}, "tones must number all 3 subcarriers, not 2"),
        ({"tones": (0, 1, 1)}, "tones must ascend"),
        ({"tones": (0, 1, 2.0)}, "tones must be whole numbers"),
        ({"tones": (0, 1, 1 << 40)}, "tones must lie within"),
        ({"tones": (-10_000, 1, 2)}, "tone -10000 would be at a frequency that is not positive"),
        ({"dead_antennas": (4,)}, "dead_antennas must lie within 0 and 3"),
        ({"dead_antennas": (-1,)}, "dead_antennas must lie within 0 and 3"),
        ({"dead_antennas": (True,)}, "dead_antennas must be whole numbers"),
        ({"dead_tones": (0, 1, 2)}, "dead_tones must leave one that counts"),
    ],
)
def test_what_is_no_array_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        small_array(**changes)


def accepted(values: dict[str, Any]) -> bool:
    """Whether the values describe an array; any error but ValueError goes through."""
    try:
        ArrayGeometry.from_dict(values)
    except ValueError:
        return False
    return True


@given(st.text(), st.none() | st.floats() | st.text())
def test_an_unknown_field_is_refused(name: str, value: object) -> None:
    assert not accepted({**small_array().as_dict(), f"my_{name}": value})


@pytest.mark.parametrize("name", ["name", "antennas", "subcarriers", "carrier_hz", "element_spacing_m"])
def test_a_missing_field_is_refused(name: str) -> None:
    values = small_array().as_dict()
    del values[name]
    assert not accepted(values)


@given(
    st.sampled_from([*small_array().as_dict()]),
    st.none() | st.floats() | st.just(10**400) | st.text() | st.lists(st.floats() | st.text(), max_size=4),
)
def test_one_strange_value_is_an_array_or_a_value_error(name: str, value: object) -> None:
    if accepted({**small_array().as_dict(), name: value}):
        assert value is not None or name in ("height_m", "calibration", "tones")


def test_mismatches_name_the_field() -> None:
    assert small_array().mismatches(small_array(name="other")) == []
    assert small_array().mismatches(small_array(carrier_hz=2e9 * (1 + 1e-9))) == []
    [phrase] = small_array().mismatches(small_array(carrier_hz=3e9))
    assert phrase == "carrier_hz: 2000000000.0 against 3000000000.0"
    assert len(small_array().mismatches(small_array(antennas=8, height_m=2.0))) == 2


INTEL = (*range(-28, 0, 2), -1, *range(1, 28, 2), 28)
"""Tones of a 20 MHz Wi-Fi channel that a well-known tool gives."""


def test_tones_say_where_the_subcarriers_are() -> None:
    array = small_array(subcarriers=30, tones=INTEL)
    np.testing.assert_array_equal(array.tone_numbers, INTEL)
    np.testing.assert_allclose(array.frequencies_hz[[0, 15]], [2e9 - 28 * 312_500, 2e9 + 312_500])
    assert array.middle_hz == pytest.approx(2e9 + np.mean(INTEL) * 312_500)
    np.testing.assert_array_equal(small_array().tone_numbers, [0, 1, 2])


@pytest.mark.parametrize(
    ("tones", "dead", "common"),
    [
        (None, (), 1),
        (INTEL, (), 1),
        ((0, 2, 6, 8), (), 2),
        ((0, 2, 3, 6), (2,), 2),
        ((1, 7, 9, 4 * 6 + 1), (2,), 6),
    ],
)
def test_ranges_repeat_at_the_common_divisor_of_the_tones(
    tones: tuple[int, ...] | None, dead: tuple[int, ...], common: int
) -> None:
    """There, and at no shorter range, all tones that count have turned by whole cycles."""
    array = small_array(subcarriers=len(tones or range(4)), tones=tones, dead_tones=dead)
    assert array.unambiguous_rho_m == pytest.approx(SPEED_OF_LIGHT / 312_500 / common)
    t = array.tone_numbers[array.live_tones]
    turns = (t - t[0]) * array.rho_phase * array.unambiguous_rho_m / (2 * math.pi)
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)
    for part in (2, 3, 5):
        assert np.abs(turns / part - np.rint(turns / part)).max() > 0.1


def test_what_is_dead_adds_up_and_is_no_mismatch() -> None:
    ours, theirs = small_array(dead_antennas=(1,)), small_array(dead_antennas=(0, 1), dead_tones=(2,))
    assert ours.mismatches(theirs) == []
    both = ours.completed(theirs)
    assert (both.dead_antennas, both.dead_tones) == ((0, 1), (2,))
    np.testing.assert_array_equal(both.live_antennas, [False, False, True, True])
    np.testing.assert_array_equal(both.live_tones, [True, True, False])


def test_tones_are_compared_by_their_numbers() -> None:
    assert small_array(tones=(0, 1, 2)).mismatches(small_array()) == []
    assert small_array(tones=(0, 1, 3)).mismatches(small_array()) == [
        "tones: subcarrier 2 is number 3 against 2"
    ]
    assert len(small_array(subcarriers=2, tones=(0, 1)).mismatches(small_array())) == 1


def test_an_array_without_tones_is_described_as_ever() -> None:
    """So that programs from before tones could be told read it."""
    assert {"tones", "dead_antennas", "dead_tones"}.isdisjoint(small_array().as_dict())


def board(**changes: Any) -> ArrayGeometry:
    pose: dict[str, Any] = {"position_m": (1.0, 2.0, 3.0), "axis": (0.0, 1.0, 0.0)}
    return ArrayGeometry.of_elements("board", grid(2, 4, 0.1), 16, 2e9, 1e6, **{**pose, **changes})


def test_any_array_survives_json() -> None:
    array = board(sees="all", clock="hall", clock_shares="frequency")
    assert ArrayGeometry.from_dict(json.loads(json.dumps(array.as_dict()))) == array


def test_a_line_is_described_as_ever() -> None:
    assert not {"elements", "sees", "clock", "clock_shares"} & set(small_array().as_dict())


def test_directions_are_those_of_somebody_in_front() -> None:
    array = board()
    np.testing.assert_allclose(np.cross(array.right, array.up), array.normal)
    np.testing.assert_allclose(array.element_positions()[0], [1, 2 - 0.15, 3 + 0.05])
    np.testing.assert_allclose(array.towards(array.centre_m + np.array([3.0, 0, 4])), [0, 0.8, 0.6])
    np.testing.assert_allclose(array.facing, [0, 0, 1])
    assert ArrayGeometry.of_elements("c", circle(5, 0.1), 1, 2e9, 1e6).facing == pytest.approx([0, -1, 0])
    assert ArrayGeometry.of_elements("c", circle(5, 0.1), 1, 2e9, 1e6, sees="all").facing is None


@given(st.floats(-100, 100), st.floats(-100, 100), st.floats(0.5, 50), st.booleans())
def test_a_place_is_found_by_range_or_by_the_plane(x: float, y: float, height: float, ranged: bool) -> None:
    """A board that looks down needs no range where the plane of the UEs is known."""
    array = board(broadside=(0.0, 0.0, -1.0), height_m=height)
    point = array.centre_m + np.array([x, y, -height])
    rho = np.linalg.norm(point - array.centre_m)
    found = array.world_of(array.towards(point), rho if ranged else np.array(np.nan))
    np.testing.assert_allclose(found, point, atol=1e-6 * (1 + rho * rho / height))
    free = ArrayGeometry.from_dict({**array.as_dict(), "height_m": None})
    np.testing.assert_allclose(free.world_of(free.towards(point), rho), point, atol=1e-9 * rho)
    np.testing.assert_allclose(array.chart_of(point), point[:2])


def test_above_the_horizon_no_plane_is_met() -> None:
    assert np.isnan(board(height_m=2.0).world_of(np.array([0.0, 0.5, 0.8]), np.array(np.nan))[0])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"elements": ((0.0, 0.0, 0.0),) * 4}, "different places"),
        ({"elements": ((0.0, 0.0, 0.0),)}, "elements must be 4 positions"),
        ({"elements": ((0.0, 0.0),) * 4}, "elements must be 4 positions"),
        ({"sees": "behind"}, "sees must be one of front"),
        ({"clock": ""}, "clock must be a name"),
        ({"clock_shares": "nothing"}, "clock_shares must be one of time"),
    ],
)
def test_what_is_no_shape_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        small_array(**changes)
