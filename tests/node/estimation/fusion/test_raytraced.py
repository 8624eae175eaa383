"""Soft fusion on ray-traced streets and a hall; skipped where the channels are not there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from chachart.node.estimation.fusion.area import Area
from chachart.node.estimation.fusion.fuser import Clock, Fuser
from chachart.node.estimation.fusion.site import Site

from .conftest import RAYTRACED


def _raytraced(name: str, every: int) -> tuple[list[Site], Area, list[NDArray[Any]], NDArray[Any]]:
    """Arrays, area, frames at 10 dB of each UE's strongest array, and true positions."""
    path = RAYTRACED / f"{name}.npz"
    if not path.exists():
        pytest.skip(f"{path.name} of the ray-traced channels is not on this machine")
    with np.load(path) as z:
        iq = z["iq"][::every].astype(np.float32)
        h = (iq[..., 0] + 1j * iq[..., 1]) * z["iq_scale"][::every, :, None, None]
        sites = [
            Site(f"a{b}", z["elements"][b], z["array_R"][b][:, 0], z["freqs"]) for b in range(h.shape[1])
        ]
        position = z["position"][::every]
        edges = z["room"][:4] if "room" in z else z["area"]
    area = Area((edges[0], edges[2]), (edges[1], edges[3]), float(position[0, 2]))
    rng = np.random.default_rng(11)
    noise = np.sqrt((np.abs(h) ** 2).mean(axis=(2, 3)).max(axis=1) / 20)[:, None, None, None]
    h = h + noise * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
    return sites, area, [np.ascontiguousarray(h[:, b], np.complex64) for b in range(len(sites))], position


@pytest.mark.parametrize(
    ("name", "every", "clock", "median", "mean"),
    [
        ("street_static", 4, "shared", 0.45, 8.5),
        ("street_static", 8, "offset", 1.9, np.inf),
        ("street_static", 8, "own", 5.0, np.inf),
        ("indoor", 8, "shared", np.inf, 0.22),
        ("indoor", 16, "offset", np.inf, 0.6),
    ],
)
def test_positions_in_metres(name: str, every: int, clock: Clock, median: float, mean: float) -> None:
    sites, area, frames, position = _raytraced(name, every)
    found = Fuser(sites, area, clock).locate(frames)
    errors = np.linalg.norm(found.position - position, axis=1)
    assert np.median(errors) <= median
    assert errors.mean() <= mean


def test_outliers_are_told() -> None:
    sites, area, frames, position = _raytraced("street_static", 4)
    found = Fuser(sites, area).locate(frames)
    off = np.linalg.norm(found.position - position, axis=1) > 10
    above = found.outlier[off][:, None] > found.outlier[~off]
    assert above.mean() > 0.85  # area under the curve
