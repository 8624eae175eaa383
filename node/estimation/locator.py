"""What estimates both coordinates: frames in, columns of chart rows out."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.covariance import Grouping
from chachart.node.estimation.state import SlotState

Columns = dict[str, NDArray[Any]]
"""What is said of U UEs, (U, ...) each: columns of chart rows by their names, and beside them, for those who
go on to work with them, `power` and `noise`: per element, of the path found and of everything else."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """What is kept of K frames before anybody has taken them.

    Attributes
    ----------
    energy
        (K,) sum of |h|^2.
    kept
        (K, ...) by the name of the state that will take it.
    """

    energy: NDArray[Any]
    kept: dict[str, NDArray[Any]]

    def take(self, index: NDArray[Any]) -> Features:
        """Those of the frames that `index` picks."""
        return Features(self.energy[index], {name: kept[index] for name, kept in self.kept.items()})


class Locator(SlotState):
    """What `ChartEstimator` asks of an estimator of both coordinates: state by slot, estimates by block."""

    @abstractmethod
    def features(self, csi: NDArray[np.complex64]) -> Features:
        """What is kept of each frame (K, N_R, N_S); nothing is remembered yet."""

    @abstractmethod
    def estimate(self, group: Grouping, features: Features, position: NDArray[np.float32]) -> Columns:
        """Take a block's frames and locate its UEs; `position` (U, 3) is NaN where they do not tell it.

        There are at least theta, rho, theta_std, rho_std, snr and snapshots.
        """

    @abstractmethod
    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """What the estimate of `slot` was read from, on grids of `points`; None without a frame."""
