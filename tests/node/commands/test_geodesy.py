from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.commands.shared.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M, beside, seen_from

FAR = st.floats(-10_000, 10_000)


def earth_centred(latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """The textbook's way from geodetic coordinates, on the ellipsoid."""
    latitude, longitude = np.radians([latitude_deg, longitude_deg])
    curvature = SEMI_MAJOR_M / np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    outwards = curvature * np.cos(latitude)
    z = curvature * (1 - ECCENTRICITY_SQUARED) * np.sin(latitude)
    return np.array([outwards * np.cos(longitude), outwards * np.sin(longitude), z])


@given(latitude=st.floats(-89.5, 89.5), longitude=st.floats(-180, 180), east=FAR, north=FAR)
def test_points_come_back_to_where_they_were(
    latitude: float, longitude: float, east: float, north: float
) -> None:
    at = beside(latitude, longitude, np.array([east]), np.array([north]))
    offset = earth_centred(float(at[0][0]), float(at[1][0])) - earth_centred(latitude, longitude)
    phi, lam = np.radians([latitude, longitude])
    eastwards = np.array([-np.sin(lam), np.cos(lam), 0])
    northwards = np.array([-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)])
    assert abs(offset @ eastwards - east) < 0.05
    assert abs(offset @ northwards - north) < 0.05
    assert -180 <= at[1][0] <= 180


def test_a_degree_is_as_long_as_tables_say() -> None:
    """At 45 degrees, 1" of latitude is 30.87 m and 1" of longitude 21.90 m."""
    latitude, longitude = beside(45.0, 10.0, np.array([2190.0, 0.0]), np.array([0.0, 3087.0]))
    assert (longitude[0] - 10) * 3600 == pytest.approx(100, rel=3e-4)
    assert (latitude[1] - 45) * 3600 == pytest.approx(100, rel=3e-4)


@pytest.mark.parametrize("place", [(90.1, 0.0), (0.0, 181.0), (float("nan"), 0.0)])
def test_no_such_place(place: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="there is no place"):
        beside(*place, np.zeros(1), np.zeros(1))


@given(latitude=st.floats(-89, 89), longitude=st.floats(-180, 180), east=FAR, north=FAR)
def test_the_way_back(latitude: float, longitude: float, east: float, north: float) -> None:
    there = beside(latitude, longitude, np.array([east]), np.array([north]))
    found = seen_from(latitude, longitude, *there)
    # The point on the ground is below the one on the plane, by up to d^2 / 2R: that is not seen from above.
    assert float(found[0][0]) == pytest.approx(east, abs=0.05)
    assert float(found[1][0]) == pytest.approx(north, abs=0.05)
