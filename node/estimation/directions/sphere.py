"""Unit vectors: grids of them, tangents, and steps along these."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def fibonacci(spacing: float) -> Floats:
    """Directions (G, 3) about `spacing` radians from their neighbours, evenly over the sphere."""
    count = max(int(np.ceil(4 * np.pi / spacing**2)), 16)
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = GOLDEN_ANGLE * np.arange(count)
    flat = np.sqrt(1 - height * height)
    return np.stack([flat * np.cos(turn), height, flat * np.sin(turn)], axis=1)


def disc(normal: Floats, spacing: float) -> Floats:
    """Directions (G, 3) on the side of `normal`, about `spacing` apart in the projection on its plane."""
    count = int(np.ceil(2 / spacing)) | 1
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-1, 1, count) * (1 - 0.25 / count)] * 2))
    inside = x * x + y * y < 1
    x, y = x[inside, None], y[inside, None]
    first, second = tangents(normal[None])[:, 0]
    grid: Floats = x * first + y * second + np.sqrt(1 - x * x - y * y) * normal
    return grid


def tangents(d: Floats) -> Floats:
    """(2, K, 3): two unit vectors orthogonal to each other and to d (K, 3)."""
    # the coordinate axis that d is farthest from is never along it
    sign = np.where(d[:, 2] < 0, -1.0, 1.0)
    a = -1 / (sign + d[:, 2])
    b = d[:, 0] * d[:, 1] * a
    e = np.empty((2, len(d), 3))
    e[0, :, 0], e[0, :, 1], e[0, :, 2] = 1 + sign * d[:, 0] ** 2 * a, sign * b, -sign * d[:, 0]
    e[1, :, 0], e[1, :, 1], e[1, :, 2] = b, sign + d[:, 1] ** 2 * a, -d[:, 1]
    return e


def moved(d: Floats, e: Floats, step: Floats) -> Floats:
    """Where a step (2, K) in rad along tangents e (2, K, 3) leads from d (K, 3)."""
    size = np.hypot(*step)
    scale = np.sinc(size / np.pi)
    along = (scale * step[0])[:, None] * e[0] + (scale * step[1])[:, None] * e[1]
    reached: Floats = np.cos(size)[:, None] * d + along
    reached /= np.linalg.norm(reached, axis=1, keepdims=True)
    return reached


def unit(azimuth: Floats, elevation: Floats) -> Floats:
    """Unit vectors (..., 3) along (right, up, normal) of azimuths and elevations (...) in rad."""
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    flat = np.cos(elevation)
    return np.stack([flat * np.sin(azimuth), np.sin(elevation), flat * np.cos(azimuth)], axis=-1)
