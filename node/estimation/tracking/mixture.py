"""One step of a batched interacting-multiple-model filter on several alternatives at once.

Blom and Bar-Shalom, IEEE TAC 33(8), 1988, with the update of a probabilistic data association filter: an
observation is a mixture of Gaussians, one an alternative, and of "none of them", which leaves the prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.tracking.motion import Floats, Motions


@dataclass
class Beliefs:
    """States x, y, vx, vy: means (U, J, 4), covariances (U, J, 4, 4) and probabilities (U, J) of models."""

    mean: Floats
    covariance: Floats
    model: Floats

    def merged(self) -> tuple[Floats, Floats]:
        """Mean (U, 4) and covariance (U, 4, 4) over models."""
        return merged(self.mean, self.covariance, self.model)


@dataclass(frozen=True)
class Sightings:
    """What was observed of U UEs: M alternatives each.

    Attributes
    ----------
    points, covariances
        Positions (U, M, 2) and their covariances (U, M, 2, 2).
    log_weights
        Log probabilities (U, M), -inf for none.
    none
        Probability (U,) that it is none of them.
    density
        What a sighting of something else is worth, by m^2 (U,); None: what the tracker takes it for.
    """

    points: Floats
    covariances: Floats
    log_weights: Floats
    none: Floats
    density: Floats | None = None

    @classmethod
    def single(cls, points: Floats, covariances: Floats, none: float = 0.05) -> Sightings:
        """One point (U, 2) each with its covariance (U, 2, 2)."""
        users = len(points)
        return cls(points[:, None], covariances[:, None], np.zeros((users, 1)), np.full(users, none))

    def take(self, which: NDArray[np.bool_]) -> Sightings:
        """Those of some UEs."""
        density = None if self.density is None else self.density[which]
        return Sightings(
            self.points[which], self.covariances[which], self.log_weights[which], self.none[which], density
        )

    def brought_forward(self, now: Beliefs, late: Floats) -> Sightings:
        """As if seen `late` (U,) seconds after it was: moved along with what is believed of the velocity."""
        if not late.any():
            return self
        state, covariance = now.merged()
        moved = self.points + (late[:, None] * state[:, 2:])[:, None]
        wider = self.covariances + (late[:, None, None] ** 2 * covariance[:, 2:, 2:])[:, None]
        return Sightings(moved, wider, self.log_weights, self.none, self.density)


def merged(mean: Floats, covariance: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """First two moments over the second axis of mixtures (U, J, d), (U, J, d, d) weighted by (U, J)."""
    middle = np.einsum("uj,ujd->ud", weight, mean)
    off = mean - middle[:, None]
    spread = np.einsum("uj,ujde->ude", weight, covariance)
    return middle, spread + np.einsum("uj,ujd,uje->ude", weight, off, off)


def mixed(beliefs: Beliefs, switching: Floats) -> Beliefs:
    """Each model's prior: the models that may have changed to it, merged."""
    joint = beliefs.model[:, :, None] * switching
    model = joint.sum(axis=1)
    share = joint / np.maximum(model, 1e-300)[:, None]
    mean = np.einsum("uij,uid->ujd", share, beliefs.mean)
    off = beliefs.mean[:, :, None] - mean[:, None]
    covariance = np.einsum("uij,uide->ujde", share, beliefs.covariance)
    covariance += np.einsum("uij,uijd,uije->ujde", share, off, off)
    return Beliefs(mean, covariance, model)


def predicted(beliefs: Beliefs, motions: Motions, dt: Floats) -> Beliefs:
    """Beliefs `dt` (U,) seconds later."""
    prior = mixed(beliefs, motions.switching(dt))
    f = motions.transition(dt)
    mean = np.einsum("ujde,uje->ujd", f, prior.mean)
    covariance = f @ prior.covariance @ f.swapaxes(-1, -2) + motions.noise(dt)
    return Beliefs(mean, covariance, prior.model)


def updated(prior: Beliefs, seen: Sightings, density: float) -> tuple[Beliefs, Floats, Floats]:
    """Beliefs after a sighting, its log evidence (U,), and the probability (U,) that it was none of them.

    `density` is what a sighting of something else is worth, by m^2, where it does not say so itself.
    """
    residual = seen.points[:, None] - prior.mean[:, :, None, :2]  # U J M 2
    s = prior.covariance[:, :, None, :2, :2] + seen.covariances[:, None]
    a, b, d = s[..., 0, 0], s[..., 0, 1], s[..., 1, 1]
    determinant = a * d - b * b
    inverse = np.empty_like(s)
    inverse[..., 0, 0], inverse[..., 1, 1] = d / determinant, a / determinant
    inverse[..., 0, 1] = inverse[..., 1, 0] = -b / determinant
    whitened = np.einsum("ujmde,ujme->ujmd", inverse, residual)
    distance = np.einsum("ujmd,ujmd->ujm", residual, whitened)
    log_hit = -0.5 * (distance + np.log(determinant)) - np.log(2 * np.pi)
    log_hit += (seen.log_weights + np.log1p(-seen.none)[:, None])[:, None]
    log_none = np.log(seen.none * (density if seen.density is None else seen.density))[:, None, None]
    every = np.concatenate([log_hit, np.broadcast_to(log_none, (*log_hit.shape[:2], 1))], axis=2)
    top = every.max(axis=(1, 2), keepdims=True)
    weight = np.exp(every - top)
    by_model = weight.sum(axis=2)
    total = (prior.model * by_model).sum(axis=1)
    evidence = np.log(total) + top[:, 0, 0]
    model = prior.model * by_model / total[:, None]
    weight /= by_model[:, :, None]
    gain = np.einsum("ujdp,ujmpe->ujmde", prior.covariance[..., :2], inverse)  # U J M 4 2
    shift = np.einsum("ujmde,ujme->ujmd", gain, residual)
    move = np.einsum("ujm,ujmd->ujd", weight[..., :-1], shift)
    less = np.einsum("ujm,ujmde,ujfe->ujdf", weight[..., :-1], gain, prior.covariance[..., :2])
    spread = np.einsum("ujm,ujmd,ujme->ujde", weight[..., :-1], shift, shift)
    spread -= np.einsum("ujd,uje->ujde", move, move)
    covariance = prior.covariance - less + spread
    none = (model * weight[..., -1]).sum(axis=1)
    return Beliefs(prior.mean + move, covariance, model), evidence, none
