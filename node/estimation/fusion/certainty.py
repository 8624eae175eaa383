"""How sure a fused position is: its covariance, what else it could be, and whether it is an outlier."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from chachart.node.estimation.fusion.climb import Peaks
from chachart.node.estimation.fusion.site import Floats

Singles = NDArray[np.float32]

HESSIAN_SHARE = 0.1
"""Variance by inverse curvature: the other paths of a channel shift a peak by less than they flatten it."""
SPREAD_SHARE = 0.25
"""Mean square distance of outliers by the variance of a UE that could be anywhere in the area."""
LOG_ODDS = {"one": 1.0, "std": 0.9, "agreement": -0.75, "purity": -1.1, "rival": 0.37}
"""Of an error of more than 10 m: a logistic regression on ray-traced streets and a hall, rounded."""
APART_M = 5.0
"""A top farther away than this is a rival."""
_SAME_M = 0.5
"""Tops nearer to each other than this are one."""
_LEAST_CURVATURE = 1e-4
_FAINTEST = -4.0
_TAKES_PART = 0.1


class Said(Protocol):
    """What arrays say about positions."""

    most: Singles
    weight: Singles

    def shares(self, points: Floats, offset: Floats | None) -> Singles:
        """Shares (U, Q, B) of the arrays' energy that waves from `points` (U, Q, 3) explain."""


@dataclass(frozen=True)
class Fused:
    """Where U UEs are.

    Attributes
    ----------
    position
        World positions (U, 3) in metres; NaN for a UE that no array has heard.
    covariance
        Of the position, (U, 3, 3) in m^2, the chance of being an outlier included.
    outlier
        Probability (U,) that the position is more than 10 m off.
    arrays
        How many arrays took part, (U,).
    offset_m
        What the UE's clock adds to every range, (U,); NaN where it is not estimated.
    tops, top_covariances, top_scores
        The alternatives that were followed up: positions (U, M, 3), their own covariances (U, M, 3, 3), and
        log likelihoods (U, M), -inf for one that is the same as another.
    shares
        Of each array's largest single path, the part (U, B) that the position explains.
    purity
        The largest part (U,) of an array's energy that the position explains.
    """

    position: Floats
    covariance: Floats
    outlier: Floats
    arrays: NDArray[np.int64]
    offset_m: Floats
    tops: Floats
    top_covariances: Floats
    top_scores: Floats
    shares: Floats
    purity: Floats

    def __len__(self) -> int:
        return len(self.position)

    @classmethod
    def concatenate(cls, parts: Sequence[Fused]) -> Fused:
        """All UEs of `parts`, in order."""
        return cls(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)})


def judged(said: Said, peaks: Peaks, basis: Floats, spread: Floats) -> Fused:
    """The best of the tops, and how sure it is.

    Parameters
    ----------
    said, peaks
        The arrays' likelihoods and their tops.
    basis
        What coordinates (d,) of the area do to a position, (d, 3).
    spread
        Covariance (3, 3) of a UE that could be anywhere in the area.
    """
    users = np.arange(len(peaks.fit))
    best = peaks.fit.argmax(axis=1)
    position = peaks.points[users, best]
    covariances = _inverse(peaks.curvature)[..., : len(basis), : len(basis)]
    share = said.shares(peaks.points, peaks.offset)[users, best].astype(np.float64)
    explained = share / said.most
    away = np.linalg.norm(peaks.points - position[:, None], axis=2)
    gap = peaks.fit - peaks.fit[users, best][:, None]
    signs = {
        "one": np.ones(len(users)),
        "std": np.log(np.sqrt(np.trace(covariances[users, best], axis1=1, axis2=2))),
        "agreement": (said.weight * explained).sum(axis=1),
        "purity": np.log1p(
            (explained**4 * np.maximum(share, 1e-3) / np.maximum(1 - share, 1e-2)).sum(axis=1)
        ),
        "rival": np.maximum(np.where(away > APART_M, gap, -np.inf).max(axis=1), _FAINTEST),
    }
    odds = np.stack([LOG_ODDS[name] * value for name, value in signs.items()]).sum(axis=0)
    outlier = expit(odds)
    tops = np.einsum("di,umde,ej->umij", basis, HESSIAN_SHARE * covariances, basis)
    whole = tops[users, best] + (SPREAD_SHARE * outlier)[:, None, None] * spread
    deaf: NDArray[np.bool_] = (said.weight == 0).all(axis=1)
    offset = np.full(len(users), np.nan) if peaks.offset is None else peaks.offset[users, best]
    return Fused(
        position=np.where(deaf[:, None], np.nan, position),
        covariance=np.where(deaf[:, None, None], np.nan, whole),
        outlier=np.where(deaf, 1.0, outlier),
        arrays=(said.weight >= _TAKES_PART).sum(axis=1),
        offset_m=np.where(deaf, np.nan, offset),
        tops=peaks.points,
        top_covariances=tops,
        top_scores=np.where(_repeated(peaks, best), -np.inf, peaks.fit),
        shares=explained,
        purity=share.max(axis=1),
    )


def _inverse(curvature: Floats) -> Floats:
    """Inverse of minus the Hessians (U, M, d, d), where they are not positive of the nearest that are."""
    value, vector = np.linalg.eigh(curvature)
    inverse = 1 / np.maximum(value, _LEAST_CURVATURE)
    found: Floats = np.einsum("umij,umj,umkj->umik", vector, inverse, vector)
    return found


def _repeated(peaks: Peaks, best: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Tops (U, M) that have come to the same place as the best one, or as one before them."""
    apart = np.linalg.norm(peaks.points[:, :, None] - peaks.points[:, None], axis=3)
    is_best = np.arange(apart.shape[1]) == best[:, None]
    earlier = np.tril(np.ones(apart.shape[1:], np.bool_), -1) & ~is_best[:, :, None]
    found: NDArray[np.bool_] = ((apart < _SAME_M) & (earlier | is_best[:, None, :])).any(axis=2) & ~is_best
    return found
