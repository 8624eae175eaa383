"""Positions from one array: what `joint` finds, in the form that fusion gives to a tracker.

With one array there is nothing to be outvoted by, so that the judgement of `joint`, which knows the noise and
how echoes deceive a single array, says more than the likelihood that several arrays share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.fusion.certainty import Fused
from chachart.node.estimation.fusion.site import Complex, Floats

AT_ONCE = 256
UNKNOWN_DOUBT = 0.1
"""Where `joint` does not say how likely its path is the direct one."""
ANYWHERE_M2 = 1e6
"""Variance of each coordinate where nothing is known."""
LEAST_M = 0.01
STEP = 1e-4
"""Relative steps by which coordinates are differentiated."""


class SingleArray:
    """Locates UEs from one frame each of one array; see `Fuser.locate`.

    Parameters
    ----------
    array
        The array; what is dead or to be corrected is its estimator's business.
    level
        World height of the UEs, None where it is free.

    Raises
    ------
    ValueError
        If `joint` cannot be had with this array.
    """

    def __init__(self, array: ArrayGeometry, level: float | None) -> None:
        if array.is_line and level is not None:
            below = float(array.centre_m[2]) - level
            array = replace(array, height_m=abs(below))
        self._array, self._level = array, level
        self._estimator = ChartEstimator(
            array, theta="joint", rho="joint", averaging="exponential", memory_frames=1, max_ues=AT_ONCE
        )

    def locate(self, frames: Sequence[Complex], near: Floats | None = None) -> Fused:
        """Positions of U UEs from complex64 (U, N_R, N_S); `near` says nothing here."""
        csi = frames[0]
        parts = []
        for start in range(0, len(csi), AT_ONCE):
            part = csi[start : start + AT_ONCE]
            block = CsiBlock.of(part, np.arange(len(part)), np.zeros(len(part), np.int64))
            self._estimator.forget(np.iinfo(np.int64).max)
            parts.append(self._fused(self._estimator.update(block), len(part)))
        return Fused.concatenate(parts)

    def _fused(self, update: ChartUpdate, count: int) -> Fused:
        rows = update.ue.astype(np.int64)
        position = np.full((count, 3), np.nan)
        covariance = np.full((count, 3, 3), np.nan)
        outlier, purity = np.ones(count), np.zeros(count)
        position[rows] = self._places(update.theta, update.rho, update)
        covariance[rows] = self._covariances(update)
        direct = update["p_direct"]
        outlier[rows] = np.where(np.isfinite(direct), 1 - direct, UNKNOWN_DOUBT)
        gain = 10 ** (update.snr / 10)
        purity[rows] = gain / (1 + gain)
        known = np.zeros(count, np.int64)
        known[rows] = 1
        lost = ~np.isfinite(position).all(axis=1)
        tops = np.where(lost[:, None], self._array.centre_m, position)
        vague = lost | ~np.isfinite(covariance).all(axis=(1, 2))
        spreads = np.where(vague[:, None, None], ANYWHERE_M2 * np.eye(3), covariance)
        return Fused(
            position=position,
            covariance=covariance,
            outlier=outlier,
            arrays=known,
            offset_m=np.full(count, np.nan),
            tops=tops[:, None],
            top_covariances=spreads[:, None],
            top_scores=np.zeros((count, 1)),
            shares=(1 - outlier)[:, None],
            purity=purity,
        )

    def _places(self, theta: Floats, rho: Floats, update: ChartUpdate) -> Floats:
        """World positions (K, 3)."""
        array = self._array
        if not array.is_line:
            return np.column_stack([update.x, update.y, update["z"]])
        x, y = array.chart_xy(theta, rho)
        world = array.centre_m + x[:, None] * array.normal + y[:, None] * array.right
        if self._level is not None:
            world[:, 2] = self._level
        return world

    def _covariances(self, update: ChartUpdate) -> Floats:
        """Of the world positions (K, 3, 3), from the deviations of angle and distance."""
        found = np.zeros((len(update), 3, 3))
        if not self._array.is_line:
            found[:, 0, 0], found[:, 1, 1] = update["x_var"], update["y_var"]
            found[:, 0, 1] = found[:, 1, 0] = update["xy_cov"]
            found[:, 2, 2] = update["z_var"]
            return found
        theta, rho = update.theta, np.maximum(update.rho, LEAST_M)
        here = self._places(theta, rho, update)
        turned = (self._places(theta + STEP, rho, update) - here) / STEP
        farther = (self._places(theta, rho * (1 + STEP), update) - here) / (STEP * rho)[:, None]
        for along, std in ((turned, update["theta_std"]), (farther, update["rho_std"])):
            part = along * std[:, None]
            found += part[:, :, None] * part[:, None, :]
        return found
