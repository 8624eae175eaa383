"""How good a chart is, where positions are known.

Trustworthiness and continuity (Venna and Kaski 2001), with U_K(i) the K nearest neighbours of i in the chart
and r(i, j) the rank of j among i's neighbours by true distance, 1 for the nearest:

    TW(K) = 1 - 2 / (N K (2N - 3K - 1)) sum_i sum_{j in U_K(i)} max(r(i, j) - K, 0)

and CT the same with the two spaces exchanged. Of equal distances the lower index counts as the nearer. (Where
no two distances are equal this is scikit-learn's result; where some are, its order is arbitrary.)

Both are means over points i, so a random sample of them, the anchors, gives an unbiased figure with a
standard error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.similarity import figures, in_degrees

Points = NDArray[np.float64]

DEFAULT_K_SHARE = 0.05
LEAST_K = 5
"""With one neighbour or two, TW and CT are mostly chance; of very few UEs fewer are allowed."""
TARGET_ERROR = 8e-4
"""Sampling stops once both standard errors are below this ..."""
MOST_ANCHORS = 4096
"""... or after so many anchors."""

UNIVERSE = 8192
"""Sampled, neighbours are ranked among so many points, or as many more as leave 100 neighbours."""

_FEWEST_ANCHORS = 128
_FEWEST_NEIGHBOURS = 100
_CHUNK_BYTES = 1 << 19


@dataclass(frozen=True, slots=True)
class Neighbourhoods:
    """TW and CT at `k` neighbours, their standard errors (0 where exact) and how many anchors gave them."""

    tw: float
    ct: float
    k: int
    tw_error: float
    ct_error: float
    anchors: int


def assess(chart: ChartUpdate, array: ArrayGeometry, k: int | None, exact_ues: int) -> dict[str, Any]:
    """Everything at once, as plain values.

    Parameters
    ----------
    chart
        Rows whose position is known.
    array
        The array of the chart; positions are compared in its frame.
    k
        Neighbours; None is 5 % of the UEs.
    exact_ues
        Up to so many UEs, TW and CT are exact; beyond, sampled.

    Returns
    -------
    dict
        `tw`, `ct`, `k`, `ues`, `tw_error`, `ct_error`, `anchors`, `stress`, and the errors of
        `similarity.figures`.

    Raises
    ------
    ValueError
        If a position is unknown or in degrees, or there are too few for `k`.
    """
    if chart.position is None:
        raise ValueError("no reference position is known")
    if in_degrees(chart.position):
        raise ValueError("the known positions lie within a centimetre: they look like degrees, not metres")
    truth = np.stack(chart.truth_of(array), axis=1)
    estimate = np.stack([chart.x, chart.y], axis=1)
    sampled = len(chart) > exact_ues
    near = neighbourhoods(truth, estimate, k, rng=np.random.default_rng(len(chart)) if sampled else None)
    return {
        "tw": near.tw,
        "ct": near.ct,
        "k": near.k,
        "ues": len(chart),
        "tw_error": near.tw_error,
        "ct_error": near.ct_error,
        "anchors": near.anchors,
        "stress": kruskal_stress(truth, estimate, most=exact_ues),
    } | figures(truth, estimate)


def neighbourhoods(
    truth: Points, chart: Points, k: int | None = None, *, rng: np.random.Generator | None = None
) -> Neighbourhoods:
    """TW and CT of `chart` (N, D) against `truth` (N, D').

    Parameters
    ----------
    k
        Neighbours; None is 5 % of N, but at least `LEAST_K` where N allows it.
    rng
        Draws anchors until both standard errors are below `TARGET_ERROR`. Of a large chart it first draws
        `UNIVERSE` points to rank, and takes as much smaller a k: what counts is the share k / N. None takes
        every point, exactly.

    Raises
    ------
    ValueError
        If the shapes differ, a coordinate is not finite, or not 1 <= k < N / 2 (beyond which the measure is
        not defined).
    """
    n = len(truth)
    _check(truth, chart)
    if k is None:
        k = max(round(DEFAULT_K_SHARE * n), min(LEAST_K, (n - 1) // 2), 1)
    if not 1 <= k < n / 2:
        raise ValueError(f"k must be at least 1 and below half the {n} UEs with a known position, not {k}")
    asked, spaces, order = k, [truth.astype(np.float64), chart.astype(np.float64)], np.arange(n)
    if rng is not None:
        order = rng.permutation(n)
        universe = max(UNIVERSE, math.ceil(_FEWEST_NEIGHBOURS * n / k))
        if n > universe:
            k, n, spaces = round(k * universe / n), universe, [s[order[:universe]] for s in spaces]
            order = np.arange(universe)
        order = order[:MOST_ANCHORS]
    step = max(_CHUNK_BYTES // (8 * n), 1)
    scale = 2 / (k * (2 * n - 3 * k - 1))
    penalties = np.zeros((0, 2))
    for i in range(0, len(order), step):
        penalties = np.concatenate([penalties, _penalties(spaces[0], spaces[1], order[i : i + step], k)])
        if (
            rng is not None
            and len(penalties) >= _FEWEST_ANCHORS
            and _error(penalties, n).max() * scale < TARGET_ERROR
        ):
            break
    tw, ct = 1 - scale * penalties.mean(axis=0)
    tw_error, ct_error = scale * _error(penalties, n)
    return Neighbourhoods(float(tw), float(ct), asked, float(tw_error), float(ct_error), len(penalties))


def kruskal_stress(truth: Points, chart: Points, *, most: int = 4096) -> float:
    """Kruskal's stress: sqrt(sum (d - b e)^2 / sum d^2) over all pairs' true distances d and chart distances
    e.

    b = sum d e / sum e^2 is the best scale, so 0 is a perfect chart and 1 tells nothing. Of more than `most`
    points, `most` at even steps stand for all.

    Raises
    ------
    ValueError
        If the shapes differ or a coordinate is not finite.
    """
    _check(truth, chart)
    pick = np.linspace(0, len(truth) - 1, min(len(truth), most)).round().astype(np.intp)
    truth, chart = truth[pick].astype(np.float64), chart[pick].astype(np.float64)
    dd = de = ee = 0.0
    step = max(_CHUNK_BYTES // (8 * len(pick)), 1)
    for i in range(0, len(pick), step):
        rows = slice(i, i + step)
        d, e = cdist(truth[rows], truth), cdist(chart[rows], chart)
        dd += float(np.vdot(d, d))
        de += float(np.vdot(d, e))
        ee += float(np.vdot(e, e))
    if dd == 0 or ee == 0:
        return 0.0 if dd == ee else 1.0
    return float(np.sqrt(max(1 - de * de / (dd * ee), 0.0)))


def _check(truth: Points, chart: Points) -> None:
    if truth.ndim != 2 or chart.ndim != 2 or len(truth) != len(chart) or not len(truth):
        raise ValueError(f"truth {truth.shape} and chart {chart.shape} must be points, as many in each")
    if not (np.isfinite(truth).all() and np.isfinite(chart).all()):
        raise ValueError("every position and chart coordinate must be finite")


def _error(penalties: Points, n: int) -> Points:
    """Standard error of the mean over anchors drawn without replacement."""
    m = len(penalties)
    if m == n:
        return np.zeros(2)
    error: Points = penalties.std(axis=0, ddof=1) * np.sqrt((1 - m / n) / m)
    return error


def _penalties(truth: Points, chart: Points, anchors: NDArray[np.intp], k: int) -> Points:
    """Sums of r - K over each anchor's intruders (TW) and its missed neighbours (CT), (anchors, 2)."""
    distances = []
    for space in (truth, chart):
        d = cdist(space[anchors], space, "sqeuclidean")
        d[np.arange(len(anchors)), anchors] = -1  # the point itself comes first, whatever coincides with it
        distances.append(d)
    ordered = [np.sort(d, axis=1) for d in distances]
    near = [_nearest(d, s, k) for d, s in zip(distances, ordered, strict=True)]
    result = np.zeros((len(anchors), 2))
    for column, (judge, other) in enumerate(((0, 1), (1, 0))):
        row, point = np.divmod(np.flatnonzero(near[other] > near[judge]), len(truth))
        rank = _ranks(distances[judge], ordered[judge], row, point)
        result[:, column] = np.bincount(row, rank - k, minlength=len(anchors))
    return result


def _nearest(d: Points, ordered: Points, k: int) -> NDArray[np.bool_]:
    """Which points are the row's own and its K nearest; of equals, those of lower index."""
    limit = ordered[:, k, None]
    near = d <= limit
    for row in np.flatnonzero(ordered[:, k + 1] == ordered[:, k]):
        equal = np.flatnonzero(d[row] == limit[row])
        surplus = int(near[row].sum()) - (k + 1)
        near[row, equal[len(equal) - surplus :]] = False
    return near


def _ranks(d: Points, ordered: Points, row: NDArray[np.intp], point: NDArray[np.intp]) -> NDArray[np.intp]:
    """How many of the row's points come before `point`, the row's own included: its rank, by bisection."""
    n = d.shape[1]
    value = d[row, point]
    flat, base = ordered.reshape(-1), row * n - 1
    rank = np.zeros(len(row), np.intp)
    step = 1 << (n.bit_length() - 1)
    while step:
        further = rank + step
        nearer = flat[base + np.minimum(further, n)] < value
        rank = np.where(nearer & (further <= n), further, rank)
        step >>= 1
    following = ordered[row, np.minimum(rank + 1, n - 1)]
    for i in np.flatnonzero((following == value) & (rank < n - 1)):
        rank[i] += np.count_nonzero(d[row[i], : point[i]] == value[i])
    return rank
