"""How far a chart is from the truth: as it is, and after the turn, scale and shift that bring it closest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

MOST_SCALE = 0.1
"""A fit that scales by more than this, or mirrors, hides that the chart is wrong."""


@dataclass(frozen=True, slots=True)
class Fit:
    """truth ~ scale * chart, mirrored or not, turned, then shifted (Umeyama 1991).

    Attributes
    ----------
    scale, turn_rad, mirrored, shift_m
        Of the chart; a mirrored one has its y turned around before it is turned.
    errors_m
        Distances (N,) that are left.
    """

    scale: float
    turn_rad: float
    mirrored: bool
    shift_m: tuple[float, float]
    errors_m: Points

    def warnings(self) -> list[str]:
        """What the fit hides, in words."""
        found = []
        if self.mirrored:
            found.append("the best fit mirrors the chart: left and right are exchanged")
        if abs(self.scale - 1) > MOST_SCALE:
            found.append(f"the best fit scales the chart by {self.scale:.3g}: its distances are wrong")
        return found


def best_fit(truth: Points, chart: Points) -> Fit:
    """The similarity that brings a chart (N, 2) closest to the truth (N, 2) in least squares.

    Raises
    ------
    ValueError
        If the shapes differ or a coordinate is not finite.
    """
    _check(truth, chart)
    centre, middle = truth.mean(axis=0), chart.mean(axis=0)
    a, b = truth - centre, chart - middle
    left, singular, right = np.linalg.svd(b.T @ a)
    spread = float(np.vdot(b, b))
    scale = float(singular.sum()) / spread if spread else 0.0
    turn = (left @ right).T
    errors: Points = np.linalg.norm(a - scale * b @ turn.T, axis=1)
    shift = centre - scale * turn @ middle
    mirrored = truth.shape[1] == 2 and float(np.linalg.det(turn)) < 0
    angle = float(np.arctan2(turn[1, 0], turn[0, 0])) if truth.shape[1] == 2 else 0.0
    return Fit(scale, angle, mirrored, (float(shift[0]), float(shift[1])), errors)


def errors_as_they_are(truth: Points, chart: Points) -> Points:
    """Distances (N,) between truth and chart (N, D), in the frame of the truth.

    Raises
    ------
    ValueError
        If the shapes differ or a coordinate is not finite.
    """
    _check(truth, chart)
    errors: Points = np.linalg.norm(truth - chart, axis=1)
    return errors


def figures(truth: Points, chart: Points) -> dict[str, Any]:
    """Errors as they are and after the best fit, and the fit, as plain values.

    `error_m`, `error_mean_m`, `error_p90_m`: median, mean and 90th percentile as they are; `fit_error_m` and
    so on: after the fit of `fit_turn_deg`, `fit_mirrored`, `fit_scale`, `fit_shift_x_m`, `fit_shift_y_m`;
    `warnings`: what the fit hides.
    """
    fit = best_fit(truth, chart)
    found: dict[str, Any] = {}
    for prefix, errors in (("", errors_as_they_are(truth, chart)), ("fit_", fit.errors_m)):
        found[f"{prefix}error_m"] = float(np.median(errors))
        found[f"{prefix}error_mean_m"] = float(errors.mean())
        found[f"{prefix}error_p90_m"] = float(np.percentile(errors, 90))
    return found | {
        "fit_turn_deg": float(np.degrees(fit.turn_rad)),
        "fit_mirrored": fit.mirrored,
        "fit_scale": fit.scale,
        "fit_shift_x_m": fit.shift_m[0],
        "fit_shift_y_m": fit.shift_m[1],
        "warnings": fit.warnings(),
    }


def in_degrees(position: NDArray[Any]) -> bool:
    """Whether known positions (N, 3) look like degrees of latitude and longitude taken for metres.

    They do where many lie within a centimetre of one another, far from the origin: so no array tells them
    apart, and nobody measures them.
    """
    plane = np.asarray(position, np.float64)[:, :2]
    span = np.ptp(plane, axis=0)
    distinct = len(np.unique(plane, axis=0))
    far = np.abs(plane.mean(axis=0)).max() > 100 * span.max()
    return bool(distinct > 3 and span.max() < 0.01 and far and np.abs(plane).max() <= 180)


def _check(truth: Points, chart: Points) -> None:
    if truth.ndim != 2 or chart.ndim != 2 or len(truth) != len(chart) or not len(truth):
        raise ValueError(f"truth {truth.shape} and chart {chart.shape} must be points, as many in each")
    if not (np.isfinite(truth).all() and np.isfinite(chart).all()):
        raise ValueError("every position and chart coordinate must be finite")
