"""theta and rho each by a method of its own: rho by a spectral or by an amplitude method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.amplitude import AmplitudeSum, ranging
from chachart.node.estimation.axis import AxisEstimate, SpectralAxis
from chachart.node.estimation.covariance import Grouping, Weights
from chachart.node.estimation.manifold import AngleManifold, DelayManifold
from chachart.node.estimation.options import AMPLITUDE, Options
from chachart.node.estimation.slots import Slots
from chachart.node.geometry import ArrayGeometry

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


class Locator(Protocol):
    """What `ChartEstimator` asks of an estimator of both coordinates: state by slot, estimates by block."""

    def resize(self, capacity: int) -> None:
        """Have state for `capacity` slots."""

    def clear(self, slots: Slots) -> None:
        """Start `slots` afresh."""

    def update(self, group: Grouping, csi: NDArray[np.complex64], known_rho: Floats) -> Located:
        """Take a block's frames (K, N_R, N_S) and locate its UEs; `known_rho` (U,) is NaN where unknown."""

    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """What the estimate of `slot` was read from, on grids of `points`; None without a frame."""


class SeparateLocator:
    """Angle from the covariance over antennas, range from that over subcarriers or from the amplitude.

    Raises
    ------
    ValueError
        If a method does not fit the array; the message begins with the argument's name.
    """

    def __init__(self, array: ArrayGeometry, options: Options) -> None:
        step = None if options.theta_step_deg is None else np.radians(options.theta_step_deg)
        self._theta = SpectralAxis(
            "theta", options.theta, AngleManifold.of(array), step, array.subcarriers, options
        )
        self._weights = Weights(options.decay)
        self._rho: SpectralAxis | None = None
        self._parts: list[Any] = [self._weights, self._theta]
        if options.rho in AMPLITUDE:
            self._amplitude = AmplitudeSum(options.amplitude, array.antennas, options.decay)
            self._ranging = ranging(
                options.rho,
                reference=options.isq_reference,
                train_ues=options.lr_train_ues,
                log_range=options.lr_log_range,
            )
            self._parts += [self._amplitude, self._ranging]
        else:
            manifold = DelayManifold.of(array, options.rho_max_m)
            self._rho = SpectralAxis(
                "rho", options.rho, manifold, options.rho_step_m, array.antennas, options
            )
            self._parts.append(self._rho)

    def resize(self, capacity: int) -> None:
        """Have state for `capacity` slots."""
        for part in self._parts:
            part.resize(capacity)

    def clear(self, slots: Slots) -> None:
        """Start `slots` afresh."""
        for part in self._parts:
            part.clear(slots)

    def update(self, group: Grouping, csi: NDArray[np.complex64], known_rho: Floats) -> Located:
        """Take a block's frames (K, N_R, N_S) and locate its UEs; rho is NaN before LR has its training."""
        weight, frames = self._weights.add(group)
        theta = self._theta.update(group, csi, weight, frames)
        if self._rho is not None:
            at = self._rho.update(group, csi.swapaxes(1, 2), weight, frames)
            rho, rho_std = at.value, at.std
        else:
            s = self._amplitude.update(group, csi, weight, theta.power, _least_power(theta, csi, frames))
            rho, rho_std = self._ranging.ranges(group.slots, s, known_rho)
        snr = 10 * np.log10(theta.power / theta.noise)
        return Located(theta.value, rho, theta.std, rho_std, snr, frames)

    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """theta_grid_rad and theta_spectrum, and the same of rho where a spectral method gives it."""
        _, frames = self._weights.of(np.array([slot]))
        if frames[0] == 0:
            return None
        grid, values = self._theta.spectrum(slot, float(frames[0]), points)
        result: dict[str, Any] = {"theta_grid_rad": grid, "theta_spectrum": values}
        if self._rho is not None:
            grid, values = self._rho.spectrum(slot, float(frames[0]), points)
            result |= {"rho_grid_m": grid, "rho_spectrum": values}
        return result


def _least_power(theta: AxisEstimate, csi: NDArray[Any], frames: Floats) -> Floats:
    """One standard deviation of the mean noise power: less signal cannot be told from none."""
    floor: Floats = theta.noise / np.sqrt(frames * csi.shape[1] * csi.shape[2])
    return floor
