"""A mast with a board and two circles in ray-traced streets: how far off directions of UEs in sight are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "raytraced" / "big.npz"
pytestmark = pytest.mark.skipif(not DATA.exists(), reason=f"{DATA} is not there")

LIMITS = {"ura64": (0.06, 0.2), "uca16": (0.16, 1.1), "uca5": (0.75, 3.9)}
"""Median errors in degrees of azimuth and elevation; circles see below and above alike."""


def streets(name: str, seed: int) -> tuple[ArrayGeometry, np.ndarray, np.ndarray, np.ndarray]:
    """The array, one frame at 10 dB of each UE that it has in sight in front, azimuths and elevations."""
    z: Any = np.load(DATA)
    number = z["array_names"].tolist().index(name)
    normal, right, up = z["array_R"][number].T
    place = z["array_position"][number]
    own = (z[f"elements_{name}"] - place) @ np.stack([right, up, normal], axis=1)
    array = ArrayGeometry.of_elements(
        name,
        own,
        64,
        float(z["freqs"][0]),
        781250.0,
        position_m=tuple(place),
        axis=tuple(right),
        broadside=tuple(normal),
    )
    azimuth, elevation = z["azimuth"][:, number], z["elevation"][:, number]
    seen = z["ura64_los" if name == "ura64" else "uca_los"].astype(bool)
    if name == "ura64":
        seen &= np.abs(azimuth) < np.pi / 2
    iq = z[f"iq_{name}"][seen].astype(np.float32)
    h = iq[..., 0] + 1j * iq[..., 1]
    h /= np.sqrt((np.abs(h) ** 2).mean(axis=(1, 2), keepdims=True))
    noise = np.random.default_rng(seed).standard_normal((*h.shape, 2)).view(np.complex128)[..., 0]
    return array, (h + noise * np.sqrt(0.05)).astype(np.complex64), azimuth[seen], elevation[seen]


@pytest.mark.parametrize("name", LIMITS)
def test_joint_directions_in_streets(name: str) -> None:
    array, csi, azimuth, elevation = streets(name, seed=0)
    chart = ChartEstimator(array, theta="joint", rho="joint", rho_max_m=380.0).update(
        csi, ue=np.arange(len(csi))
    )
    off = np.abs(np.angle(np.exp(1j * (chart["azimuth"] - azimuth))))
    above = np.abs(np.abs(chart["elevation"]) - np.abs(elevation))
    assert np.degrees(np.median(off)) < LIMITS[name][0]
    assert np.degrees(np.median(above)) < LIMITS[name][1]
