"""theta and rho each by a method of its own: rho by a spectral or by an amplitude method."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.amplitude import AmplitudeSum, ranging
from chachart.node.estimation.axis import SpectralAxis
from chachart.node.estimation.covariance import Bank, Grouping, Weights
from chachart.node.estimation.directions.axis import DirectionAxis
from chachart.node.estimation.judge import judge, probability
from chachart.node.estimation.locator import Columns, Features, Locator
from chachart.node.estimation.manifold import AngleManifold, DelayManifold
from chachart.node.estimation.noise import NoiseFloor
from chachart.node.estimation.options import AMPLITUDE, NONE, Options
from chachart.node.estimation.periodogram import energy

Floats = NDArray[np.float64]

NO_THETA: Final = (math.pi / 2, math.pi / math.sqrt(12))
"""theta and its deviation where there is no angle: the mean of all there are, and their spread."""
NO_RHO: Final = (1.0, math.nan)
"""rho and its deviation where there is no distance: charts of directions are circles of radius 1."""


class SeparateLocator(Locator):
    """Angle from the covariance over antennas, range from that over subcarriers or from the amplitude.

    Either may be "none"; what is left then tells signal from noise. Power alone, of one antenna and one
    tone, has no noise to be told from. Arrays that are no uniform line have directions for an angle.
    """

    def __init__(self, array: ArrayGeometry, options: Options) -> None:
        step = None if options.theta_step_deg is None else np.radians(options.theta_step_deg)
        delay = self.delay = DelayManifold.of(array, options.rho_max_m)
        antennas = int(array.live_antennas.sum())
        self._array, self._weights = array, Weights(options.decay)
        self._elements = antennas * delay.size
        self._theta: SpectralAxis | DirectionAxis | None = None
        self._rho: SpectralAxis | None = None
        self._level: SpectralAxis | None = None
        super().__init__(weights=self._weights)
        self._takers: dict[str, SpectralAxis | DirectionAxis | AmplitudeSum] = {}
        if options.theta != NONE and array.is_uniform:
            angle = AngleManifold.of(array)
            self._level = SpectralAxis("theta", options.theta, angle, step, delay.size, options)
            self._takers["theta"] = self._theta = self._level
        elif options.theta != NONE:
            self._takers["theta"] = self._theta = DirectionAxis(options.theta, array, delay.size, options)
        if options.rho in AMPLITUDE:
            self._amplitude = AmplitudeSum(options.amplitude, array.antennas, antennas, options.decay)
            self._ranging = ranging(
                options.rho,
                reference=options.isq_reference,
                train_ues=options.lr_train_ues,
                log_range=options.lr_log_range,
            )
            self._takers["amplitude"] = self._amplitude
            self.children["ranging"] = self._ranging
            if self._level is None and delay.size > 1:
                self._level = SpectralAxis("level", "bartlett", delay, None, antennas, options)
                self._takers["level"] = self._level
            if self._level is None:
                self._power = self.children["power"] = Bank((), np.float64, options.decay)
            else:
                self._floor = NoiseFloor(self._level.whole.lattice)
        elif options.rho != NONE:
            self._rho = SpectralAxis("rho", options.rho, delay, options.rho_step_m, antennas, options)
            self._takers["rho"] = self._rho
        self._amplitudes = options.rho in AMPLITUDE
        self._judged = [axis for axis in (self._theta, self._rho) if isinstance(axis, SpectralAxis)]
        self._echoes = options.echoes
        self.children |= self._takers

    def features(self, csi: NDArray[np.complex64]) -> Features:
        """Of each axis there is, and the amplitude."""
        kept: dict[str, NDArray[Any]] = {}
        if self._theta is not None:
            kept["theta"] = self._theta.of_frames(csi)
        for axis in (self._rho, self._level):
            if axis is not None and axis.name not in kept:
                kept[axis.name] = axis.of_frames(csi.swapaxes(1, 2))
        if self._amplitudes:
            kept["amplitude"] = self._amplitude.of_frames(csi)
        first = self._theta or self._rho or self._level
        if first is None:
            return Features(energy(csi.reshape(len(csi), -1)), kept)
        return Features(first.energy(kept[first.name]), kept)

    def estimate(self, group: Grouping, features: Features, position: NDArray[np.float32]) -> Columns:
        """Take a block's frames and locate its UEs; rho is NaN before LR has its training."""
        # all is taken before anything is worked out, so that no error leaves a frame half added
        weight, frames = self._weights.add(group)
        sums = {name: taker.take(group, features.kept[name]) for name, taker in self._takers.items()}
        if self._amplitudes and self._level is None:
            sums["power"] = self._power.add(group, np.asarray(features.energy, np.float64))
        count, relative = len(group), False
        at: Columns = {}
        for axis in (self._rho, self._level, self._theta):
            if axis is not None and axis.name not in at:
                at |= axis.estimate(group, sums[axis.name], weight, frames)
        at["snapshots"] = frames
        self._judge(at)
        at["snr"] = 10 * np.log10(at["power"] / at["noise"]) if "power" in at else np.full(count, np.nan)
        if self._theta is None:
            at["theta"], at["theta_std"] = (np.full(count, value) for value in NO_THETA)
        if self._amplitudes:
            if self._level is None:
                power = np.asarray(sums["power"] / (weight * self._elements), np.float64)
            else:
                power = self._signal(self._level, group, weight, frames)
            s = self._amplitude.estimate(sums["amplitude"], weight, power)
            known_rho = self._array.theta_rho(position)[1]
            at["rho"], at["rho_std"] = self._ranging.ranges(group.slots, s, known_rho, position)
            relative = self._ranging.relative
        elif self._rho is None:
            at["rho"], at["rho_std"] = (np.full(count, value) for value in NO_RHO)
            relative = True
        if relative:
            at["relative"] = np.ones(count, np.int64)
        return at

    def _judge(self, at: Columns) -> None:
        """Add deviations, and the probability that the path is the direct one.

        Two axes of one method are judged by what is seen on both.
        """
        axes, direct = self._judged, np.ones(len(at["snapshots"]))
        growth = [np.full(len(direct), -np.inf)] * len(axes)
        if self._echoes and len(axes) == 2 and axes[0].method == axes[1].method:
            both = np.concatenate([at["theta_evidence"], at["rho_evidence"]], axis=1)
            *growth, odds = judge(axes[0].method, 3)(both).T
            direct = probability(odds)
        elif self._echoes:
            for n, axis in enumerate(axes):
                evidence = at[f"{axis.name}_evidence"]
                growth[n], odds = judge(f"{axis.method}.{axis.name}", 2)(evidence).T
                direct = direct * probability(odds)
        for axis, one in zip(axes, growth, strict=True):
            at[f"{axis.name}_std"] = axis.deviation(at, one)
        at["p_direct"] = direct if axes else np.full(len(direct), np.nan)

    def _signal(self, level: SpectralAxis, group: Grouping, weight: Floats, frames: Floats) -> Floats:
        """Power per element of all paths together, at least what could not be told from none."""
        lags = level.mean_lags(group.slots, weight)
        snapshots = frames * level.snapshots
        noise = self._floor.power(lags, snapshots)
        return np.maximum(lags[:, 0].real - noise, noise / np.sqrt(level.whole.size * snapshots))

    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """theta_grid_rad and theta_spectrum, and the same of rho, where a spectral method gives them."""
        _, frames = self._weights.of(np.array([slot]))
        if frames[0] == 0:
            return None
        result: dict[str, Any] = {}
        if isinstance(self._theta, DirectionAxis):
            result |= self._theta.spectrum(slot, float(frames[0]), points)
        elif self._theta is not None:
            grid, values = self._theta.spectrum(slot, float(frames[0]), points)
            result |= {"theta_grid_rad": grid, "theta_spectrum": values}
        if self._rho is not None:
            grid, values = self._rho.spectrum(slot, float(frames[0]), points)
            result |= {"rho_grid_m": grid, "rho_spectrum": values}
        return result
