"""What a tracker is told of a fused position: its alternatives, and the chance that it is none of them."""

from __future__ import annotations

import numpy as np

from chachart.node.estimation.fusion.certainty import Fused
from chachart.node.estimation.tracking.mixture import Sightings

LEAST_DOUBT, MOST_DOUBT = 0.02, 0.95
"""Nothing is certain, and nothing is useless."""


def sightings(fused: Fused) -> Sightings:
    """The tops of the likelihood in the plane, weighted by how well they fit."""
    best = fused.top_scores.max(axis=1, keepdims=True)
    share = np.exp(fused.top_scores - best)
    with np.errstate(divide="ignore"):
        log_weights = np.log(share / share.sum(axis=1, keepdims=True))
    doubt = np.clip(fused.outlier, LEAST_DOUBT, MOST_DOUBT)
    return Sightings(fused.tops[..., :2], fused.top_covariances[..., :2, :2], log_weights, doubt)
