"""Places on the earth from metres east and north of one, and back. Pure arithmetic, WGS 84."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)

Floats = NDArray[np.float64]


def beside(
    latitude_deg: float, longitude_deg: float, east_m: NDArray[Any], north_m: NDArray[Any]
) -> tuple[Floats, Floats]:
    """Latitude and longitude (K,) in degrees of points (K,) on the plane that touches the ellipsoid there.

    Exact for the plane, which is within a centimetre of the distances on the ground up to 10 km away.
    (Bowring 1976 for the way back to latitudes.)

    Raises
    ------
    ValueError
        If the latitude is not within 90 degrees, or the longitude not within 180.
    """
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        raise ValueError(f"there is no place at latitude {latitude_deg}, longitude {longitude_deg}")
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    sine, cosine = np.sin(latitude), np.cos(latitude)
    curvature = SEMI_MAJOR_M / np.sqrt(1 - ECCENTRICITY_SQUARED * sine**2)
    # In the meridian's own plane: outwards from the axis, east, and along the axis.
    outwards = curvature * cosine - np.asarray(north_m) * sine
    along = curvature * (1 - ECCENTRICITY_SQUARED) * sine + np.asarray(north_m) * cosine
    east = np.asarray(east_m, np.float64)
    from_axis = np.hypot(outwards, east)
    semi_minor = SEMI_MAJOR_M * (1 - FLATTENING)
    reduced = np.arctan2(along * SEMI_MAJOR_M, from_axis * semi_minor)
    found = np.arctan2(
        along + ECCENTRICITY_SQUARED / (1 - FLATTENING) ** 2 * semi_minor * np.sin(reduced) ** 3,
        from_axis - ECCENTRICITY_SQUARED * SEMI_MAJOR_M * np.cos(reduced) ** 3,
    )
    turned = longitude + np.arctan2(east, outwards)
    return np.degrees(found), np.degrees((turned + np.pi) % (2 * np.pi) - np.pi)


def seen_from(
    latitude_deg: float, longitude_deg: float, latitudes_deg: NDArray[Any], longitudes_deg: NDArray[Any]
) -> tuple[Floats, Floats]:
    """Metres (K,) to the east and north of one place, on the plane that touches the ellipsoid there."""
    here = _earth_centred(np.array([latitude_deg]), np.array([longitude_deg]))
    offset = _earth_centred(np.asarray(latitudes_deg), np.asarray(longitudes_deg)) - here
    phi, lam = np.radians([latitude_deg, longitude_deg])
    east = offset @ np.array([-np.sin(lam), np.cos(lam), 0.0])
    north = offset @ np.array([-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)])
    return east, north


def _earth_centred(latitudes_deg: NDArray[Any], longitudes_deg: NDArray[Any]) -> Floats:
    """Places (K, 3) on the ellipsoid in metres from the middle of the earth."""
    phi, lam = np.radians(latitudes_deg), np.radians(longitudes_deg)
    curvature = SEMI_MAJOR_M / np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(phi) ** 2)
    outwards = curvature * np.cos(phi)
    along = curvature * (1 - ECCENTRICITY_SQUARED) * np.sin(phi)
    return np.column_stack([outwards * np.cos(lam), outwards * np.sin(lam), along])
