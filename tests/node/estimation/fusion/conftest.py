"""Arrays round a square, and the waves that they receive."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from chachart.node.estimation.fusion.area import Area
from chachart.node.estimation.fusion.site import Site

LIGHT = 299_792_458.0
RAYTRACED = Path(__file__).parents[5] / "shared" / "data" / "raytraced"


def board(name: str, position: tuple[float, float, float], yaw: float, tones: int = 64) -> Site:
    """A board of 2 x 4 at 3.5 GHz that looks towards `yaw`, with tones over 50 MHz."""
    normal = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    right = np.cross(up, normal)
    half = LIGHT / 3.5e9 / 2
    elements = [
        np.array(position) + half * ((column - 1.5) * right + (0.5 - row) * up)
        for row in range(2)
        for column in range(4)
    ]
    return Site(name, np.array(elements), normal, 3.5e9 + (np.arange(tones) - tones / 2) * 50e6 / tones)


def received(
    site: Site, positions: NDArray[Any], amplitude: float = 1.0, offset_m: float | NDArray[Any] = 0.0
) -> NDArray[np.complex64]:
    """Spherical waves (U, N, S) from `positions` (U, 3); behind the array, nothing."""
    away = np.linalg.norm(positions[:, None] - site.elements, axis=2)
    far = away + np.broadcast_to(np.asarray(offset_m, float).reshape(-1, 1), away.shape)
    wave = amplitude * np.exp(-2j * np.pi * far[..., None] * site.tones_hz / LIGHT)
    wave[(positions - site.centre) @ site.normal <= 0] = 0
    return wave.astype(np.complex64)


def noisy(csi: NDArray[np.complex64], snr_db: float, seed: int) -> NDArray[np.complex64]:
    """With white noise `snr_db` below the waves' unit power."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(csi.shape) + 1j * rng.standard_normal(csi.shape)
    return (csi + noise * np.sqrt(0.5 / 10 ** (snr_db / 10))).astype(np.complex64)


@pytest.fixture
def sites() -> list[Site]:
    """Four boards at the corners of a square of 40 m, 4 m high, that look inwards."""
    corners = [(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)]
    return [board(f"b{i}", (x, y, 4.0), np.arctan2(-y, -x)) for i, (x, y) in enumerate(corners)]


@pytest.fixture
def area() -> Area:
    """The square."""
    return Area((-20.0, -20.0), (20.0, 20.0), 1.5)


@pytest.fixture
def positions() -> NDArray[np.float64]:
    """24 UEs in it."""
    rng = np.random.default_rng(5)
    return np.column_stack([rng.uniform(-15, 15, (24, 2)), np.full(24, 1.5)])
