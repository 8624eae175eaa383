"""rho = "auto", with any theta: a spectral and the joint method side by side, and `RangeFusion` over both."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.covariance import Grouping
from chachart.node.estimation.directions.joint import DirectionLocator
from chachart.node.estimation.fused_range import RangeFusion
from chachart.node.estimation.joint import JointLocator
from chachart.node.estimation.locator import Columns, Features, Locator
from chachart.node.estimation.options import JOINT, Options
from chachart.node.estimation.separate import SeparateLocator

SPECTRAL, BOTH = "spectral.", "joint."
OF_RANGE = ("rho", "rho_std", "rho_noise_std", "rho_u", "rho_u_std", "rho_evidence", "p_direct")


class AutoLocator(Locator):
    """Directions by the method that is asked for, distances by what both methods and the power say.

    Parameters
    ----------
    array, options
        As of `ChartEstimator`.
    """

    def __init__(self, array: ArrayGeometry, options: Options) -> None:
        self._array, self._jointly = array, options.theta == JOINT
        theta = "bartlett" if self._jointly else options.theta
        self._spectral = SeparateLocator(
            array, options.model_copy(update={"theta": theta, "rho": "bartlett"})
        )
        make: type[JointLocator | DirectionLocator] = JointLocator if array.is_uniform else DirectionLocator
        self._joint = make(array, options.model_copy(update={"theta": JOINT, "rho": JOINT}))
        cell_m = array.unambiguous_rho_m / self._spectral.delay.lattice.span
        self._ranging = RangeFusion(cell_m, options.rho_max_m, options.echoes)
        super().__init__(spectral=self._spectral, joint=self._joint, ranging=self._ranging)

    def features(self, csi: NDArray[np.complex64]) -> Features:
        """Those of both."""
        spectral, joint = self._spectral.features(csi), self._joint.features(csi)
        kept = {SPECTRAL + name: values for name, values in spectral.kept.items()}
        return Features(spectral.energy, kept | {BOTH + name: values for name, values in joint.kept.items()})

    def estimate(self, group: Grouping, features: Features, position: NDArray[np.float32]) -> Columns:
        """Take a block's frames and locate its UEs; those whose position is known teach."""
        spectral = self._spectral.estimate(group, _of(SPECTRAL, features), position)
        joint = self._joint.estimate(group, _of(BOTH, features), position)
        at = joint if self._jointly else spectral
        known_rho = self._array.theta_rho(position)[1]
        ranges = self._ranging.ranges(group.slots, spectral, joint, known_rho)
        if "p_direct" in at:  # of the direction, too
            ranges["p_direct"] = np.fmin(ranges["p_direct"], at["p_direct"])
        return {name: values for name, values in at.items() if name not in OF_RANGE} | ranges

    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """Of the method that gives theta; of rho what Bartlett's estimate, or the joint one, is read from."""
        return (self._joint if self._jointly else self._spectral).spectrum(slot, points)


def _of(prefix: str, features: Features) -> Features:
    cut = len(prefix)
    kept = {name[cut:]: values for name, values in features.kept.items() if name.startswith(prefix)}
    return Features(features.energy, kept)
