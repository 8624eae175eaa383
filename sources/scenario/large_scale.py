"""Large-scale parameters of the multipath channels: what they are drawn from, and how they follow a position.

The numbers are those of QuaDRiGa's BERLIN_UMa_LOS (`QLOS`) and BERLIN_UMa_NLOS (`QNLOS`), urban macro cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.sources.scenario.fields import GaussianFields

Floats = NDArray[np.float64]

PARAMETERS = ("DS", "K", "SF", "AsD", "AsA", "EsD", "EsA", "XPR")
"""Delay spread, Rician K, shadow fading, azimuth spread at the array (D) and at the UE (A), elevation spreads
alike, cross-polar ratio: the order of all tables here."""


@dataclass(frozen=True)
class Statistics:
    """What distinguishes one kind of surroundings from another.

    Attributes
    ----------
    mean, std, decorrelation_m
        (8,) of each of `PARAMETERS`: log10 s, dB, dB, log10 degrees four times, dB.
    correlation
        Cross-correlations that are not zero.
    clusters
        Groups of paths, the direct one included.
    delay_factor
        r_DS: how much wider than the delay spread the delays are drawn.
    cluster_spread_deg
        Width of a cluster: azimuth at the array, at the UE, elevation at the array, at the UE.
    path_loss_db
        (a, b): a log10 D + b.
    """

    mean: tuple[float, ...]
    std: tuple[float, ...]
    decorrelation_m: tuple[float, ...]
    correlation: dict[tuple[str, str], float]
    clusters: int
    delay_factor: float
    cluster_spread_deg: tuple[float, float, float, float]
    path_loss_db: tuple[float, float]


QLOS = Statistics(
    mean=(-6.69, 2.7, 0.0, 0.65, 1.61, 0.70, 1.16, 9.0),
    std=(0.30, 2.3, 3.7, 0.23, 0.17, 0.20, 0.14, 4.3),
    decorrelation_m=(130, 23, 90, 8, 11, 15, 11, 20),
    correlation={
        ("DS", "K"): -0.35,
        ("DS", "SF"): -0.62,
        ("DS", "AsA"): 0.2,
        ("DS", "EsD"): -0.4,
        ("K", "SF"): 0.6,
        ("K", "AsA"): -0.2,
        ("K", "EsA"): -0.3,
        ("SF", "AsD"): -0.2,
        ("SF", "AsA"): -0.4,
        ("SF", "EsA"): -0.6,
        ("AsD", "AsA"): 0.5,
        ("AsD", "EsD"): 0.5,
        ("AsD", "EsA"): -0.3,
        ("AsA", "EsA"): 0.3,
    },
    clusters=15,
    delay_factor=2.5,
    cluster_spread_deg=(2, 12, 3, 3),
    path_loss_db=(21, 47.5),
)
QNLOS = Statistics(
    mean=(-6.47, -6.3, 0.0, 0.65, 1.50, 0.90, 1.25, 7.75),
    std=(0.20, 3.7, 4.0, 0.22, 0.16, 0.20, 0.14, 4.3),
    decorrelation_m=(100, 40, 100, 25, 45, 30, 25, 20),
    correlation={
        ("DS", "K"): -0.1,
        ("DS", "SF"): -0.65,
        ("DS", "AsD"): 0.1,
        ("DS", "EsD"): -0.4,
        ("DS", "EsA"): -0.2,
        ("K", "SF"): 0.12,
        ("K", "AsA"): -0.2,
        ("K", "EsA"): -0.2,
        ("SF", "AsA"): -0.2,
        ("SF", "EsA"): -0.5,
        ("AsD", "AsA"): 0.5,
        ("AsD", "EsD"): 0.5,
        ("AsD", "EsA"): -0.3,
        ("AsA", "EsA"): 0.3,
    },
    clusters=25,
    delay_factor=2.0,
    cluster_spread_deg=(6, 15, 3, 7),
    path_loss_db=(28.5, 38),
)


@dataclass(frozen=True, slots=True)
class LargeScale:
    """Large-scale parameters at K places.

    Attributes
    ----------
    delay_spread_s, rice, gain, cross_polar
        (K,): rms delay spread, Rician K, gain with shadow fading and path loss, cross-polar ratio; powers are
        ratios, not dB.
    azimuth_bs, azimuth_ue, elevation_bs, elevation_ue
        (K,): rms angular spreads in radians.
    """

    delay_spread_s: Floats
    rice: Floats
    gain: Floats
    cross_polar: Floats
    azimuth_bs: Floats
    azimuth_ue: Floats
    elevation_bs: Floats
    elevation_ue: Floats


class LargeScaleFields:
    """Correlated large-scale parameters over the plane: neighbours have alike, and a walking UE meets them.

    Parameters
    ----------
    statistics
        Means, deviations, correlations.
    rng
        Draws the eight fields.
    """

    def __init__(self, statistics: Statistics, rng: np.random.Generator) -> None:
        self._statistics = statistics
        self._fields = GaussianFields(np.array(statistics.decorrelation_m), rng)
        self._mixing = correlation_root(statistics)

    def at(self, position: NDArray[Any], distance_m: NDArray[Any]) -> LargeScale:
        """Parameters at world positions (K, 3) that are `distance_m` (K,) from the array."""
        s = self._statistics
        z = self._fields.at(position) @ self._mixing
        value = np.array(s.mean) + np.array(s.std) * z
        delay, rice, shadow, az_bs, az_ue, el_bs, el_ue, cross = value.T
        a, b = s.path_loss_db
        return LargeScale(
            delay_spread_s=10**delay,
            rice=10 ** (rice / 10),
            gain=10 ** ((shadow - a * np.log10(distance_m) - b) / 10),
            cross_polar=10 ** (cross / 10),
            azimuth_bs=np.deg2rad(10**az_bs),
            azimuth_ue=np.deg2rad(10**az_ue),
            elevation_bs=np.deg2rad(10**el_bs),
            elevation_ue=np.deg2rad(10**el_ue),
        )


def correlation_root(statistics: Statistics) -> Floats:
    """Symmetric square root (8, 8) of the matrix of cross-correlations."""
    matrix = np.eye(len(PARAMETERS))
    for pair, value in statistics.correlation.items():
        i, j = (PARAMETERS.index(name) for name in pair)
        matrix[i, j] = matrix[j, i] = value
    eigenvalue, vector = np.linalg.eigh(matrix)
    root: Floats = (vector * np.sqrt(eigenvalue)) @ vector.T
    return root
