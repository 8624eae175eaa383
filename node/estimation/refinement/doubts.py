"""What rows of a chart say of how far off they may be, as refinement takes it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import FUSION

Floats = NDArray[np.float64]

UNKNOWN_M = 1e3
"""Deviation of a coordinate of which none is told."""


def outliers(chart: ChartUpdate) -> Floats:
    """Probability (U,) that a row is farther off than `covariances` say; 0 for rows of one array."""
    found: Floats = np.nan_to_num(np.asarray(chart["outlier"], np.float64), nan=0.0)
    return found


def covariances(chart: ChartUpdate, array: ArrayGeometry) -> Floats:
    """Of rows that are no outliers, (U, 2, 2) in m^2; of fused rows 0, for theirs are of outliers mostly."""
    found = np.zeros((len(chart), 2, 2))
    if chart.method.theta == FUSION:
        return found
    middle = np.zeros(2) if array.is_line else array.centre_m[:2]
    away = np.column_stack([chart.x, chart.y]) - middle
    far = np.maximum(np.linalg.norm(away, axis=1), 1e-6)
    outward = away / far[:, None]
    across = np.column_stack([-outward[:, 1], outward[:, 0]])
    angle = chart["azimuth_std"] if "azimuth_std" in chart.columns else chart.theta_std
    for along, std in ((outward, chart.rho_std), (across, far * angle)):
        variance = np.square(np.nan_to_num(std, nan=UNKNOWN_M, posinf=UNKNOWN_M))
        found += variance[:, None, None] * along[:, :, None] * along[:, None, :]
    return found
