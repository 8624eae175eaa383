"""theta and rho each by a method of its own: rho by a spectral or by an amplitude method."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.amplitude import AmplitudeSum, ranging
from chachart.node.estimation.axis import SpectralAxis
from chachart.node.estimation.covariance import Grouping, Weights
from chachart.node.estimation.locator import Columns, Features, Locator
from chachart.node.estimation.manifold import AngleManifold, DelayManifold
from chachart.node.estimation.noise import NoiseFloor
from chachart.node.estimation.options import AMPLITUDE, Options

Floats = NDArray[np.float64]


class SeparateLocator(Locator):
    """Angle from the covariance over antennas, range from that over subcarriers or from the amplitude."""

    def __init__(self, array: ArrayGeometry, options: Options) -> None:
        step = None if options.theta_step_deg is None else np.radians(options.theta_step_deg)
        self._theta = SpectralAxis(
            "theta", options.theta, AngleManifold.of(array), step, array.subcarriers, options
        )
        self._array, self._weights = array, Weights(options.decay)
        self._rho: SpectralAxis | None = None
        super().__init__(weights=self._weights, theta=self._theta)
        self._takers: dict[str, SpectralAxis | AmplitudeSum] = {"theta": self._theta}
        if options.rho in AMPLITUDE:
            self._floor = NoiseFloor(array.antennas)
            self._amplitude = AmplitudeSum(options.amplitude, array.antennas, options.decay)
            self._ranging = ranging(
                options.rho,
                reference=options.isq_reference,
                train_ues=options.lr_train_ues,
                log_range=options.lr_log_range,
            )
            self._takers["amplitude"] = self._amplitude
            self.children["ranging"] = self._ranging
        else:
            manifold = DelayManifold.of(array, options.rho_max_m)
            self._rho = SpectralAxis(
                "rho", options.rho, manifold, options.rho_step_m, array.antennas, options
            )
            self._takers["rho"] = self._rho
        self.children |= self._takers

    def features(self, csi: NDArray[np.complex64]) -> Features:
        """Of both axes, or of the angle axis and the amplitude."""
        conjugate = csi.conj()
        theta = self._theta.of_frames(csi, conjugate)
        energy = theta[:, 0].real if theta.ndim == 2 else np.einsum("kii->k", theta).real
        if self._rho is None:
            return Features(energy, {"theta": theta, "amplitude": self._amplitude.of_frames(csi)})
        rho = self._rho.of_frames(csi.swapaxes(1, 2), conjugate.swapaxes(1, 2))
        return Features(energy, {"theta": theta, "rho": rho})

    def estimate(self, group: Grouping, features: Features, position: NDArray[np.float32]) -> Columns:
        """Take a block's frames and locate its UEs; rho is NaN before LR has its training."""
        # all is taken before anything is worked out, so that no error leaves a frame half added
        weight, frames = self._weights.add(group)
        sums = {name: self._takers[name].take(group, kept) for name, kept in features.kept.items()}
        at = self._theta.estimate(group, sums["theta"], weight, frames)
        at["snr"] = 10 * np.log10(at["power"] / at["noise"])
        at["snapshots"] = frames
        if self._rho is not None:
            return self._rho.estimate(group, sums["rho"], weight, frames) | at
        s = self._amplitude.estimate(sums["amplitude"], weight, self._signal(group, weight, frames))
        known_rho = self._array.theta_rho(position)[1]
        at["rho"], at["rho_std"] = self._ranging.ranges(group.slots, s, known_rho)
        return at

    def _signal(self, group: Grouping, weight: Floats, frames: Floats) -> Floats:
        """Power per element of all paths together, at least what could not be told from none."""
        lags = self._theta.mean_lags(group.slots, weight)
        snapshots = frames * self._array.subcarriers
        noise = self._floor.power(lags, snapshots)
        return np.maximum(lags[:, 0].real - noise, noise / np.sqrt(self._array.antennas * snapshots))

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
