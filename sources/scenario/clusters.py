"""Clusters and sub-paths of the multipath channels.

What belongs to a UE for good is drawn once (`Draws`); what follows the large-scale parameters of the place
where it is just then (powers, delays, departure angles) comes from `scale`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.sources.scenario.large_scale import LargeScale, Statistics

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

SUB_PATHS = 20
"""Plane waves in a cluster."""
_HALF = (0.0447, 0.1413, 0.2492, 0.3715, 0.5129, 0.6797, 0.8844, 1.1481, 1.5195, 2.1551)
OFFSETS = np.array([sign * offset for offset in _HALF for sign in (1, -1)])
"""Angles (20,) of the sub-paths about the cluster's, in units of the cluster's spread."""
ENDS = ("azimuth_bs", "azimuth_ue", "elevation_bs", "elevation_ue")
"""The four angles of a path, in the order of every table of angles here."""

_CROSS_POLAR_JITTER_DB = 0.43
_MAX_STRETCH = np.array([3.0, 3.0, 1.5, 1.5])


@dataclass(frozen=True, slots=True)
class Draws:
    """What is drawn for U UEs with L clusters beside the direct path, M sub-paths in each.

    Attributes
    ----------
    delay
        (U, L) raw delays -ln U.
    angle
        (U, L, 4) raw angles pi (U - 1/2), of `ENDS`.
    power
        (U, L) raw powers.
    phase
        float32 (U, L, M) phases of the sub-paths, in cycles.
    gain_db
        float32 (U, L, M) deviations from the cross-polar ratio, in dB.
    order
        uint8 (4, U, L, M) which of `OFFSETS` each sub-path has at each angle.
    """

    delay: Floats
    angle: Floats
    power: Floats
    phase: Floats32
    gain_db: Floats32
    order: NDArray[np.uint8]

    @staticmethod
    def draw(statistics: Statistics, ues: int, rng: np.random.Generator) -> Draws:
        """Draw for `ues` UEs."""
        paths = statistics.clusters - 1
        delay = -np.log1p(-rng.random((ues, paths)))
        angle = np.pi * (rng.random((ues, paths, 4)) - 0.5)
        squared, plain = angle[..., :2] ** 2, np.abs(angle[..., 2:])
        exponent = (statistics.delay_factor - 1) * delay + 0.56 * squared.sum(-1) + 0.76 * plain.sum(-1)
        shape = (ues, paths, SUB_PATHS)
        order = np.broadcast_to(np.arange(SUB_PATHS, dtype=np.uint8), (4, *shape))
        return Draws(
            delay=delay,
            angle=angle,
            power=np.exp(-exponent),
            phase=rng.random(shape, dtype=np.float32),
            gain_db=_CROSS_POLAR_JITTER_DB * rng.standard_normal(shape, dtype=np.float32),
            order=rng.permuted(order, axis=-1),
        )

    def take(self, ue: NDArray[Any]) -> Draws:
        """The draws of the UEs `ue` (indices, K)."""
        return Draws(
            self.delay[ue],
            self.angle[ue],
            self.power[ue],
            self.phase[ue],
            self.gain_db[ue],
            self.order[:, ue],
        )


@dataclass(frozen=True, slots=True)
class Clusters:
    """Clusters as K places see them.

    Attributes
    ----------
    direct
        (K,) power of the direct path; all powers of a UE add up to 1.
    power
        (K, L) powers of the others.
    delay_s
        (K, L) delays over the direct path's.
    angle
        (K, L, 4) angles of `ENDS` off the direct path's, in radians.
    """

    direct: Floats
    power: Floats
    delay_s: Floats
    angle: Floats


def scale(draws: Draws, large: LargeScale) -> Clusters:
    """Give K UEs' clusters the powers, delays and angles that the large-scale parameters ask for.

    The rms spreads, weighted with power and with the direct path at zero, become those of `large`, but no
    angle is stretched by more than 3 (azimuth) and 1.5 (elevation).
    """
    direct = large.rice / (1 + large.rice)
    power = draws.power * ((1 - direct) / draws.power.sum(axis=1))[:, None]
    delay = draws.delay * (large.delay_spread_s / _rms(draws.delay[..., None], power)[:, 0])[:, None]
    wanted = np.stack([getattr(large, end) for end in ENDS], axis=1)
    stretch = np.minimum(wanted / _rms(draws.angle, power), _MAX_STRETCH)
    return Clusters(direct, power, delay, draws.angle * stretch[:, None])


def _rms(value: Floats, power: Floats) -> Floats:
    """Spread (K, C) of values (K, L, C) with powers (K, L), the rest of the power being at zero."""
    mean = np.einsum("kl,klc->kc", power, value)
    spread: Floats = np.sqrt(np.einsum("kl,klc->kc", power, value**2) - mean**2)
    return spread


def unit_vectors(azimuth: NDArray[Any], elevation: NDArray[Any]) -> tuple[Any, Any, Any]:
    """Components x (direct path), y, z of directions, for angles off the direct path.

    Elevations beyond 90 degrees come out mirrored with the azimuth turned round, as on a sphere.
    """
    flat = np.cos(elevation)
    return flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)


def frame(direction: Floats) -> Floats:
    """Orthonormal axes (K, 3, 3), rows x, y, z: x along `direction` (K, 3), y horizontal."""
    flat = np.hypot(direction[:, 0], direction[:, 1])
    level = flat > 1e-9
    safe = np.where(level, flat, 1.0)
    cos, sin = np.where(level, direction[:, 0] / safe, 1.0), np.where(level, direction[:, 1] / safe, 0.0)
    across = np.stack([-sin, cos, np.zeros_like(sin)], axis=1)
    return np.stack([direction, across, np.cross(direction, across)], axis=1)
