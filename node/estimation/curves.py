"""Trustworthiness and continuity for every number of neighbours at once.

`quality` defines both. A pair (i, j) with j at rank a in one space and b > a in the other is penalised by
b - K for each K from a to b - 1; so both curves follow from all ranks by two running sums.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

Floats = NDArray[np.float64]
Ranks = NDArray[np.int32]

_CHUNK_BYTES = 1 << 22


def neighbour_ranks(points: NDArray[Any]) -> Ranks:
    """Rank (N, N) of j among the neighbours of i, 1 for the nearest and 0 for i itself.

    Of equal distances the lower index counts as the nearer. Takes 4 N^2 bytes.

    Raises
    ------
    ValueError
        If `points` is not (N, D) or a coordinate is not finite.
    """
    if points.ndim != 2 or not np.isfinite(points).all():
        raise ValueError(f"points {points.shape} must be (N, D), all finite")
    n = len(points)
    ranks = np.empty((n, n), np.int32)
    places = np.arange(n, dtype=np.int32)
    step = max(_CHUNK_BYTES // (8 * n), 1)
    for i in range(0, n, step):
        own = np.arange(i, min(i + step, n))
        distances = cdist(points[own], points, "sqeuclidean")
        distances[np.arange(len(own)), own] = -1  # the point itself comes first, whatever coincides with it
        order = np.argsort(distances, axis=1, kind="stable")
        np.put_along_axis(ranks[own[0] : own[-1] + 1], order, places[None], axis=1)
    return ranks


def neighbourhood_curves(truth: Ranks, chart: Ranks, most: int) -> tuple[Floats, Floats]:
    """TW and CT for K = 1 ... `most`, each (most,), from the ranks of `neighbour_ranks`.

    Raises
    ------
    ValueError
        If the shapes differ or not 1 <= most < N / 2.
    """
    n = len(truth)
    if truth.shape != chart.shape or not 1 <= most < n / 2:
        raise ValueError(f"ranks {truth.shape} and {chart.shape} must be alike, 1 <= {most} < {n} / 2")
    k = np.arange(1, most + 1)
    scale = 2 / (n * k * (2 * n - 3 * k - 1))
    return 1 - scale * _penalties(chart, truth, most), 1 - scale * _penalties(truth, chart, most)


def _penalties(near: Ranks, judge: Ranks, most: int) -> Floats:
    """Sum of b - K over the pairs with a = near <= K < b = judge, for K = 1 ... most."""
    pairs = (near > 0) & (near <= most) & (judge > near)
    a, b = near[pairs], np.minimum(judge[pairs], most + 1)
    value = judge[pairs].astype(np.float64)
    size = most + 2
    total = np.bincount(a, value, size) - np.bincount(b, value, size)
    count = np.bincount(a, minlength=size) - np.bincount(b, minlength=size)
    penalties: Floats = np.cumsum(total) - np.arange(float(size)) * np.cumsum(count)
    return penalties[1 : most + 1]
