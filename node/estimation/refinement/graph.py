"""Who has a channel like whose, and how far apart such UEs are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from chachart.node.estimation.refinement.profile import Profiles

Floats = NDArray[np.float64]

NEIGHBOURS = 10
_BLOCK_BYTES = 1 << 26
_BINS = 32
_FARTHEST = 0.95
_NEAREST = 0.1
"""No two UEs are expected nearer to each other than this part of the usual distance."""


@dataclass(frozen=True, slots=True, eq=False)
class Graph:
    """Pairs of UEs that have channels alike, both ways round.

    Attributes
    ----------
    links
        Sparse (U, U): the distances in metres that pairs are expected to have.
    usual_m
        How far apart they are where both positions are sure, root mean square: what neighbours are worth.
    """

    links: sparse.csr_array
    usual_m: float

    @property
    def first(self) -> NDArray[np.intp]:
        """First UE (E,) of each link."""
        return np.repeat(np.arange(self.links.shape[0]), np.diff(self.links.indptr))

    @property
    def second(self) -> NDArray[np.intp]:
        """Second UE (E,) of each link."""
        return np.asarray(self.links.indices, np.intp)

    @property
    def far_m(self) -> Floats:
        """Expected distance (E,) of each link."""
        return np.asarray(self.links.data, np.float64)


def nearest(profiles: Profiles, k: int) -> tuple[NDArray[np.intp], Floats]:
    """The k nearest others (U, k) of each profile by angle, and their dissimilarities: chords of a sphere."""
    size = np.linalg.norm(profiles, axis=1, keepdims=True)
    unit = profiles / np.where(size > 0, size, 1)
    count = len(unit)
    others = np.empty((count, k), np.intp)
    alike = np.empty((count, k), np.float32)
    step = max(_BLOCK_BYTES // (4 * count), 1)
    for i in range(0, count, step):
        block = unit[i : i + step] @ unit.T
        rows = np.arange(len(block))
        block[rows, i + rows] = -2
        found = np.argpartition(block, count - k, axis=1)[:, count - k :]
        others[i : i + step] = found
        alike[i : i + step] = np.take_along_axis(block, found, axis=1)
    return others, np.sqrt(np.maximum(2 - 2 * alike.astype(np.float64), 0))


def graph(profiles: Profiles, place: Floats, sure: NDArray[np.bool_], k: int = NEIGHBOURS) -> Graph:
    """The nearest neighbours by profile, and how far apart UEs with such dissimilarities are.

    Parameters
    ----------
    profiles
        (U, LENGTH).
    place
        Estimated positions (U, 2).
    sure
        The UEs (U,) that distances are learnt from.

    Raises
    ------
    ValueError
        If there are not more than `k` UEs.
    """
    count = len(profiles)
    if count <= k:
        raise ValueError(f"{count} UEs are too few: more than {k} are needed")
    others, unlike = nearest(profiles, k)
    first, second = np.repeat(np.arange(count), k), others.ravel()
    both = sure[first] & sure[second]
    far = np.linalg.norm(place[first] - place[second], axis=1)
    expected = _expected(unlike.ravel(), unlike.ravel()[both], far[both])
    usual = float(np.sqrt(np.square(far[both]).mean())) if both.any() else float(np.ptp(place, axis=0).max())
    expected = np.maximum(expected, max(_NEAREST * float(np.median(expected)), 1e-6))
    one_way = sparse.csr_array((expected, (first, second)), shape=(count, count))
    return Graph(sparse.csr_array(one_way.maximum(one_way.T)), max(usual, 1e-6))


def _expected(unlike: Floats, told: Floats, far: Floats) -> Floats:
    """Distances for dissimilarities: the medians of what is told (E,), never falling."""
    if not len(told):
        return np.ones(len(unlike))
    far = np.minimum(far, np.quantile(far, _FARTHEST))
    parts = np.array_split(np.argsort(told, kind="stable"), min(_BINS, len(told)))
    at = [float(np.median(told[part])) for part in parts]
    there = np.maximum.accumulate([float(np.median(far[part])) for part in parts])
    return np.interp(unlike, at, there)
