"""Pairs of estimators on a scene: charts, seconds and quality."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.reproduction.paper import Pair
from chachart.node.commands.reproduction.scenario import KNOWN_UES, Scene
from chachart.node.data.chart import ChartUpdate
from chachart.node.estimation.curves import Ranks, neighbour_ranks, neighbourhood_curves
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.similarity import best_fit

Floats = NDArray[np.float64]


class Spent(NamedTuple):
    """Seconds of the processor, and by the clock: the same while nobody else uses the machine."""

    processor: float
    clock: float


class Stopwatch:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.process_time(), time.perf_counter()

    def spent(self) -> Spent:
        """So far."""
        return Spent(time.process_time() - self._start[0], time.perf_counter() - self._start[1])


@dataclass(slots=True, eq=False)
class Charted:
    """A chart and how good it is.

    Attributes
    ----------
    name
        What is shown: "theta / rho", or an embedding.
    xy
        Chart coordinates (U, 2).
    tw, ct
        (most,) for K = 1 ... most neighbours.
    error_m
        Median distance from the truth after the best similarity fit.
    seconds, clock_seconds
        Of each run: of the processor, and by the clock.
    variances
        Of the errors of theta and rho over the standard deviations told; NaN where none is told.
    """

    name: str
    xy: Floats
    tw: Floats
    ct: Floats
    error_m: float
    seconds: list[float] = field(default_factory=list)
    clock_seconds: list[float] = field(default_factory=list)
    variances: tuple[float, float] = (np.nan, np.nan)

    @property
    def mean_seconds(self) -> float:
        """Mean over the runs, of the processor."""
        return float(np.mean(self.seconds))

    def as_dict(self) -> dict[str, Any]:
        """Plain values, NaN as None."""
        return {
            "name": self.name,
            "k": len(self.tw),
            "tw": float(self.tw[-1]),
            "ct": float(self.ct[-1]),
            "error_m": self.error_m,
            "seconds": self.mean_seconds,
            "seconds_of_runs": self.seconds,
            "clock_seconds_of_runs": self.clock_seconds,
            "theta_variance": None if np.isnan(self.variances[0]) else self.variances[0],
            "rho_variance": None if np.isnan(self.variances[1]) else self.variances[1],
            "tw_of_k": self.tw.round(6).tolist(),
            "ct_of_k": self.ct.round(6).tolist(),
        }


def display(pair: Pair) -> str:
    """The pair as people write it."""
    written = {"bartlett": "Bartlett", "minnorm": "MinNorm", "joint": "Joint"}
    return " / ".join(written.get(method, method.upper()) for method in pair)


def estimate(
    scene: Scene,
    pair: Pair,
    options: Mapping[str, Any],
    *,
    random_training: bool = False,
    positions: bool = True,
) -> tuple[ChartUpdate, Spent]:
    """Chart all UEs; returns one row a UE, in order, and the time spent.

    The time covers everything from frames in memory to chart coordinates: the covariances of all frames,
    the spectra and the searches of both coordinates or what stands in their place, and making the estimator.
    """
    blocks = list(scene.blocks(random_training=random_training, positions=positions))
    watch = Stopwatch()
    estimator = ChartEstimator(
        scene.array,
        **{"averaging": "mean", "lr_train_ues": KNOWN_UES, **options, "theta": pair[0], "rho": pair[1]},
    )
    updates = [estimator.update(block) for block in blocks]
    spent = watch.spent()
    chart = ChartUpdate.concatenate(updates)
    return chart.take(np.argsort(chart.ue)), spent


def judge(name: str, xy: Floats, truth: Floats, truth_ranks: Ranks, most: int) -> Charted:
    """Hold chart coordinates (U, 2) against the truth, for up to `most` neighbours."""
    tw, ct = neighbourhood_curves(truth_ranks, neighbour_ranks(xy), most)
    return Charted(name, xy, tw, ct, float(np.median(best_fit(truth, xy).errors_m)))


def judge_pair(scene: Scene, pair: Pair, chart: ChartUpdate, truth_ranks: Ranks, most: int) -> Charted:
    """As `judge`, with the variances of the normalised errors of theta and rho."""
    charted = judge(display(pair), np.stack([chart.x, chart.y], axis=1), scene.truth, truth_ranks, most)
    theta, rho = scene.array.theta_rho(scene.position)
    errors = ((chart.theta - theta) / chart.theta_std, (chart.rho - rho) / chart.rho_std)
    charted.variances = (float(np.mean(errors[0] ** 2)), float(np.mean(errors[1] ** 2)))
    return charted
