"""What a tracker is told of a position: its alternatives, and the chance that it is none of them."""

from __future__ import annotations

import numpy as np

from chachart.node.estimation.fusion.certainty import Fused
from chachart.node.estimation.tracking.mixture import Sightings

LEAST_DOUBT, MOST_DOUBT = 0.02, 0.95
"""Nothing is certain, and nothing is useless."""
ECHOES_M2 = 32.0
"""Variance of each coordinate by which echoes are off, beside deviations ..."""
BESIDE = 0.1
"""Part of the doubt in a direct path that its deviation does not tell."""
FARTHER = 4.0
"""... of which what one array takes for a path is so many variances off when it is something else."""


def sightings(fused: Fused) -> Sightings:
    """The tops of the likelihood in the plane, weighted by how well they fit."""
    best = fused.top_scores.max(axis=1, keepdims=True)
    share = np.exp(fused.top_scores - best)
    with np.errstate(divide="ignore"):
        log_weights = np.log(share / share.sum(axis=1, keepdims=True))
    doubt = np.clip(fused.outlier, LEAST_DOUBT, MOST_DOUBT)
    return Sightings(fused.tops[..., :2], fused.top_covariances[..., :2, :2], log_weights, doubt)


def single_sightings(fused: Fused) -> Sightings:
    """Of one array, whose deviations are judged for echoes: less doubt is left besides."""
    covariance = fused.top_covariances[..., :2, :2]
    wide = ECHOES_M2 * np.eye(2) + FARTHER * covariance[:, 0]
    density = 1 / (2 * np.pi * np.sqrt(np.linalg.det(wide)))
    doubt = np.clip(BESIDE * fused.outlier, LEAST_DOUBT, MOST_DOUBT)
    return Sightings(fused.tops[..., :2], covariance, np.zeros((len(fused), 1)), doubt, density)
