"""What estimates both coordinates, and what it says."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.covariance import Grouping
from chachart.node.estimation.state import SlotState

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """theta (rad) and rho (m) of U UEs with standard deviations, SNR (dB) and effective frames, each (U,)."""

    theta: Floats
    rho: Floats
    theta_std: Floats
    rho_std: Floats
    snr: Floats
    snapshots: Floats


class Locator(SlotState):
    """What `ChartEstimator` asks of an estimator of both coordinates: state by slot, estimates by block."""

    @abstractmethod
    def features(self, csi: NDArray[np.complex64]) -> list[NDArray[Any]]:
        """What is kept of each frame (K, N_R, N_S), as arrays (K, ...); nothing is remembered yet."""

    @abstractmethod
    def energy(self, features: list[NDArray[Any]]) -> NDArray[Any]:
        """Sum of |h|^2 of each frame (K,)."""

    @abstractmethod
    def estimate(
        self, group: Grouping, features: list[NDArray[Any]], position: NDArray[np.float32]
    ) -> Located:
        """Take a block's frames and locate its UEs; `position` (U, 3) is NaN where unknown."""

    @abstractmethod
    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """What the estimate of `slot` was read from, on grids of `points`; None without a frame."""
