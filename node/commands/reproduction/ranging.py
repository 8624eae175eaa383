"""What range by amplitude costs and gains: each way to take the amplitude, each fit, each training set."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from chachart.node.commands.reproduction.runs import estimate
from chachart.node.commands.reproduction.scenario import Scene
from chachart.node.estimation.quality import neighbourhoods

AMPLITUDES = ("debiased", "coherent", "noisy")
WAYS: tuple[tuple[str, str, bool, bool], ...] = (
    ("ISQ", "isq", False, False),
    ("LR", "lr", False, False),
    ("LR, random training", "lr", False, True),
    ("LR log-log", "lr", True, False),
    ("LR log-log, random training", "lr", True, True),
)
"""Name, method, whether log(rho) is fitted, whether training UEs are drawn at random."""


@dataclass(frozen=True, slots=True)
class Ranged:
    """One way to range, theta by Bartlett: TW, CT and median |rho error| over rho."""

    way: str
    amplitude: str
    tw: float
    ct: float
    rho_error: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def compare(scene: Scene, k: int, progress: Callable[[str], None]) -> Iterator[Ranged]:
    """Every way on a scene; `progress` is called with each result in words."""
    truth = scene.truth
    rho = scene.array.theta_rho(scene.position)[1]
    for way, method, log_range, random_training in WAYS:
        for amplitude in AMPLITUDES:
            options = {"amplitude": amplitude, "lr_log_range": log_range}
            chart, _ = estimate(scene, ("bartlett", method), options, random_training=random_training)
            near = neighbourhoods(truth, np.stack([chart.x, chart.y], axis=1), k)
            error = float(np.median(np.abs(chart.rho - rho) / rho))
            progress(f"{way}, {amplitude}: TW {near.tw:.4f} CT {near.ct:.4f}")
            yield Ranged(way, amplitude, near.tw, near.ct, error)
