"""Pulls UEs that nobody should trust to where UEs with channels like theirs are.

Minimised is the stress of the graph of neighbours with every UE's own likelihood as prior,

    sum_i (x_i - p_i)^T R_i (x_i - p_i) + sum_ij w_ij (|x_i - x_j| - d_ij)^2,

where R_i falls with the doubt in the estimate p_i: the square of its odds against being an outlier, and the
inverse of its covariance. The doubt grows where UEs with channels alike agree on another place (agreement
does not lessen it: echoes mislead neighbours alike), so doubts and places are worked out in turn, at first
without d_ij, then by majorisation (SMACOF; de Leeuw 1977). It needs no training and no known position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg
from scipy.special import expit

from chachart.node.estimation.refinement.graph import Graph

Floats = NDArray[np.float64]

ROUNDS, STEPS = 8, 5
"""Of doubts and places in turn, and of majorisation."""
PRIOR = 2.0
"""What even odds weigh against a link of the usual length, of which `LINKS` are reckoned with."""
LINKS = 10.0
LEAST_DOUBT, MOST_DOUBT = 0.005, 0.98
VOTES = 0.1
"""Share of trusted neighbours from which on they are believed in full."""
LEAST_CHANCE = 0.002
"""That neighbours are elsewhere though the estimate is right; how often that is so is seen in sure UEs."""
ELSEWHERE = 9.0
"""Squared deviations from where neighbours are that mean elsewhere."""
LEAST_SPREAD = 0.05
"""Variance of what neighbours say, by the square of the usual distance."""
OWN_SPREAD = 0.5
"""An estimate with a deviation below this part of the usual distance has nothing to learn from others."""
TOP_SPREADS = 4.0
"""Squared spreads within which one of a UE's own maxima is where its neighbours are."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Positions (U, 2), the probability (U,) that the estimate was right, and which UEs have been moved."""

    place: Floats
    trust: Floats
    moved: NDArray[np.bool_]


def refine(
    neighbours: Graph,
    place: Floats,
    covariance: Floats,
    outlier: Floats,
    tops: Floats | None = None,
    scores: Floats | None = None,
) -> Refined:
    """Refined positions of a chart.

    Parameters
    ----------
    neighbours
        Who has channels alike, see `graph`.
    place
        Estimates (U, 2) in metres.
    covariance
        Of estimates that are no outliers, (U, 2, 2) in m^2.
    outlier
        Probability (U,) that an estimate is one.
    tops, scores
        Other places (U, M, 2) that a UE's likelihood allows, with log likelihoods (U, M), -inf for none.
    """
    chart = _Chart(neighbours, place, covariance, outlier)
    found, trust, spread = chart.settled()
    if tops is None or scores is None:
        tops, scores = place[:, None], np.zeros((len(place), 1))
    off = np.square(tops - found[:, None]).sum(axis=2)
    fits = np.where(off < TOP_SPREADS * spread[:, None], scores, -np.inf)
    best = fits.argmax(axis=1)
    rows = np.arange(len(place))
    snapped = np.where(np.isfinite(fits[rows, best])[:, None], tops[rows, best], found)
    sharp = np.trace(covariance, axis1=1, axis2=2) / 2 < (OWN_SPREAD * neighbours.usual_m) ** 2
    trusted = trust > 0.5
    refined = np.where((trusted & sharp)[:, None], place, np.where(trusted[:, None], found, snapped))
    return Refined(refined, trust, (refined != place).any(axis=1))


class _Chart:
    """Estimates and links, lengths by the usual distance of neighbours."""

    def __init__(self, neighbours: Graph, place: Floats, covariance: Floats, outlier: Floats) -> None:
        self._unit = neighbours.usual_m
        self._middle = place.mean(axis=0)
        self._own = (place - self._middle) / self._unit
        self._covariance = covariance / self._unit**2
        self._first, self._second = neighbours.first, neighbours.second
        self._far = neighbours.far_m / self._unit
        doubt = np.clip(outlier, LEAST_DOUBT, MOST_DOUBT)
        self._odds = np.log((1 - doubt) / doubt)
        low, high = np.quantile(self._own, [0.01, 0.99], axis=0)
        self._area = float(np.prod(np.maximum(high - low, 1)))
        count = len(place)
        links = max(len(self._far) / count / 2, 1)
        weight = LINKS / links / self._far
        self._weight = weight
        matrix = sparse.csr_array((weight, (self._first, self._second)), shape=(count, count))
        self._sum: Floats = np.asarray(matrix.sum(axis=1))
        self._matrix = matrix

    def settled(self) -> tuple[Floats, Floats, Floats]:
        """Places (U, 2), trust (U,), and the variance (U,) of what neighbours say; in metres."""
        odds, place = self._odds, self._own
        for _ in range(ROUNDS):
            prior = self._prior(odds)
            place = self._balanced(prior, place, np.zeros_like(place))
            said, spread, votes = self._said(place, expit(odds))
            evidence = np.minimum(self._evidence(said, spread) * np.minimum(votes / VOTES, 1), 0)
            odds = self._odds + evidence
        prior = self._prior(odds)
        for _ in range(STEPS):
            place = self._balanced(prior, place, self._pushed(place))
        _, spread, _ = self._said(place, expit(odds))
        return self._middle + self._unit * place, expit(odds), spread * self._unit**2

    def _prior(self, odds: Floats) -> Floats:
        """R (U, 2, 2)."""
        doubt = np.exp(-2 * np.clip(odds, -6, 6)) / PRIOR
        return np.asarray(np.linalg.inv(self._covariance + doubt[:, None, None] * np.eye(2)), np.float64)

    def _balanced(self, prior: Floats, start: Floats, push: Floats) -> Floats:
        """Where prior and links balance: (L + R) x = R p + push, by conjugate gradients."""
        block = np.linalg.inv(prior + self._sum[:, None, None] * np.eye(2))
        shape = self._own.shape

        def whole(x: Floats) -> Floats:
            at = x.reshape(shape)
            pulled = self._sum[:, None] * at - self._matrix @ at
            found: Floats = (pulled + np.einsum("uij,uj->ui", prior, at)).ravel()
            return found

        def eased(x: Floats) -> Floats:
            found: Floats = np.einsum("uij,uj->ui", block, x.reshape(shape)).ravel()
            return found

        wanted = np.einsum("uij,uj->ui", prior, self._own) + push
        size = wanted.size
        operator = LinearOperator((size, size), matvec=whole, dtype=np.float64)
        easing = LinearOperator((size, size), matvec=eased, dtype=np.float64)
        found, _ = cg(operator, wanted.ravel(), x0=start.ravel(), rtol=1e-6, maxiter=500, M=easing)
        place: Floats = found.reshape(shape)
        return place

    def _pushed(self, place: Floats) -> Floats:
        """What expected distances add to the balance, (U, 2)."""
        apart = place[self._first] - place[self._second]
        length = np.maximum(np.linalg.norm(apart, axis=1), 1e-3)
        return self._summed((self._weight * self._far / length)[:, None] * apart)

    def _said(self, place: Floats, trust: Floats) -> tuple[Floats, Floats, Floats]:
        """Where trusted neighbours put each UE (U, 2), the variance of that, and their share (U,)."""
        near = 1 / (self._far**2 + 0.01)
        vote = near * trust[self._second]
        total = self._summed(vote) + 1e-12
        there = place[self._second]
        said = self._summed(vote[:, None] * there) / total[:, None]
        around = np.square(there - said[self._first]).sum(axis=1) + self._far**2
        spread = self._summed(vote * around) / total / 2 + LEAST_SPREAD
        return said, spread, total / self._summed(near)

    def _evidence(self, said: Floats, spread: Floats) -> Floats:
        """Log likelihood ratio (U,) of the own estimate against any other place, by what neighbours say."""
        whole = self._covariance + spread[:, None, None] * np.eye(2)
        off = self._own - said
        square = np.einsum("ui,uij,uj->u", off, np.linalg.inv(whole), off)
        density = np.exp(-square / 2) / (2 * np.pi * np.sqrt(np.linalg.det(whole)))
        sure = self._odds >= np.median(self._odds)
        chance = max(float((square[sure] > ELSEWHERE).mean()), LEAST_CHANCE)
        found: Floats = np.log(density * self._area + chance)
        return found

    def _summed(self, values: Floats) -> Floats:
        """Sums of values (E,) or (E, 2) over the links of each UE."""
        count = len(self._own)
        if values.ndim == 1:
            return np.bincount(self._first, values, count).astype(np.float64)
        return np.stack([np.bincount(self._first, column, count) for column in values.T], axis=1)
