"""Errors of theta and rho on a single path against the SNR, beside their Cramér-Rao bounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.reproduction.scenario import noisy
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation import bounds
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.manifold import AngleManifold, DelayManifold

Floats = NDArray[np.float64]

METHODS = ("bartlett", "mvdr", "minnorm", "music", "joint")
SNRS_DB = tuple(np.arange(-25.0, 20.1, 2.5).tolist())
JUDGED_FROM_DB = -10.0
"""The ratios of error to bound are told from here on."""
THRESHOLD_RATIO = 1.25
"""Above so many times the bound the error is beyond its threshold."""
THETA_RAD = (np.radians(30.0), np.radians(150.0))
RHO_M = (100.0, 600.0)


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Root mean squared errors of one coordinate over the SNR.

    Attributes
    ----------
    coordinate, unit
        "theta" in degrees or "rho" in metres.
    bandwidth_hz
        Of the array.
    snrs_db
        (S,).
    rmse
        By method, each (S,).
    stochastic, deterministic
        (S,) root mean square of the bounds: source unknown and Gaussian, source known to be constant.
    """

    coordinate: str
    unit: str
    bandwidth_hz: float
    snrs_db: Floats
    rmse: dict[str, Floats]
    stochastic: Floats
    deterministic: Floats

    def ratios(self, method: str) -> Floats:
        """Error over its bound, (S,): the deterministic one for the joint method, which averages frames."""
        return self.rmse[method] / (self.deterministic if method == "joint" else self.stochastic)

    def judged(self, method: str) -> tuple[float, float]:
        """Mean and largest ratio from `JUDGED_FROM_DB` on."""
        ratios = self.ratios(method)[self.snrs_db >= JUDGED_FROM_DB]
        return float(ratios.mean()), float(ratios.max())

    def threshold_db(self, method: str) -> float | None:
        """Least SNR from which on the error stays near its bound; None if it never does."""
        beyond = np.flatnonzero(self.ratios(method) > THRESHOLD_RATIO)
        after = int(beyond[-1]) + 1 if len(beyond) else 0
        return float(self.snrs_db[after]) if after < len(self.snrs_db) else None

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "coordinate": self.coordinate,
            "unit": self.unit,
            "bandwidth_hz": self.bandwidth_hz,
            "snr_db": self.snrs_db.tolist(),
            "rmse": {method: values.tolist() for method, values in self.rmse.items()},
            "bound_stochastic": self.stochastic.tolist(),
            "bound_deterministic": self.deterministic.tolist(),
            "mean_and_largest_ratio": {method: self.judged(method) for method in self.rmse},
            "threshold_db": {method: self.threshold_db(method) for method in self.rmse},
        }


def measure(
    array: ArrayGeometry,
    methods: tuple[str, ...],
    paths: int,
    frames: int,
    seed: int,
    options: Mapping[str, Any],
    progress: Callable[[str], None],
) -> tuple[Accuracy, Accuracy]:
    """Errors of theta and of rho; theta uniform over 30..150 degrees, rho over 100..600 m.

    Parameters
    ----------
    methods
        Each stands for both coordinates.
    paths
        Independent paths at each SNR, each with `frames` frames; all methods see the same.
    progress
        Called with each SNR done, in words.
    """
    rng = np.random.default_rng([seed, 4])
    theta, rho = rng.uniform(*THETA_RAD, paths), rng.uniform(*RHO_M, paths)
    angle, delay = AngleManifold.of(array), DelayManifold.of(array, np.inf)
    a, b = angle.steering(angle.u(theta)), delay.steering(delay.u(rho))
    start = np.exp(2j * np.pi * rng.random(paths))
    csi = np.einsum("u,un,us->uns", start, a, b).astype(np.complex64)
    ue = np.repeat(np.arange(paths, dtype=np.uint64), frames)
    squares = {method: np.zeros((2, len(SNRS_DB))) for method in methods}
    for n, snr_db in enumerate(SNRS_DB):
        noisy_csi = noisy(csi, frames, snr_db, seed + n).reshape(-1, *csi.shape[1:])
        block = CsiBlock(array.name, 0, ue, np.zeros(len(ue), np.int64), noisy_csi)
        for method in methods:
            estimator = ChartEstimator(
                array, **{"averaging": "mean", **options, "theta": method, "rho": method}
            )
            at = estimator.update(block)
            squares[method][:, n] = np.mean((at.theta - theta) ** 2), np.mean((at.rho - rho) ** 2)
        progress(f"single path, {array.subcarriers * array.subcarrier_spacing_hz / 1e6:g} MHz, {snr_db:g} dB")
    ratio = 10 ** (np.array(SNRS_DB)[:, None] / 10)
    bandwidth = array.subcarriers * array.subcarrier_spacing_hz

    def accuracy(
        row: int, coordinate: str, unit: str, scale: float, bound: Callable[..., Floats]
    ) -> Accuracy:
        rms = [np.sqrt(np.mean(bound(stochastic=s) ** 2, axis=1)) * scale for s in (True, False)]
        errors = {method: np.sqrt(values[row]) * scale for method, values in squares.items()}
        return Accuracy(coordinate, unit, bandwidth, np.array(SNRS_DB), errors, rms[0], rms[1])

    return (
        accuracy(
            0, "theta", "°", 180 / np.pi, lambda **s: bounds.theta_std(array, theta, ratio, frames, **s)
        ),
        accuracy(1, "rho", "m", 1.0, lambda **s: bounds.rho_std(array, ratio, frames, **s)),
    )
