"""Networks of rho = "auto": where between and before two delays the direct path is, and how surely."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.training import draws, networks
from chachart.node.estimation.fused_range import (
    LEAST_M,
    OUTPUTS,
    SPREAD_M,
    combined,
    evidence,
    excess_power,
    law_terms,
    with_power,
)
from chachart.node.estimation.judge import Judge
from chachart.node.estimation.options import JOINT

Floats = NDArray[np.float64]
Sample = dict[str, Floats]

FREEDOM = 4.0
"""Of Student's distribution, by whose likelihood ranges are fitted: wrong paths are far off."""
HIDDEN = 20


def gather(count: int, ues: int, seed: int) -> Sample:
    """Evidence, both delays, the truth and more of `count` worlds; of half of the UEs without a power law."""
    pieces: list[Sample] = []
    worlds = draws.drawn(count, ues, seed, draws.RANGE_SIZES, draws.RANGE_BANDWIDTHS_HZ)
    for n, draw in enumerate(worlds):
        if draw.array.unambiguous_rho_m > draws.FARTHEST_M:
            pieces += _of(draw)
        print(f"\r{n + 1} of {count} draws for ranges", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def _of(draw: draws.Draw) -> list[Sample]:
    csi, _, truth = draws.world(draw)
    spectral, joint = draws.located(draw, csi, "bartlett"), draws.located(draw, csi, JOINT)
    cell_m = draw.cells[1]
    seen, power = evidence(spectral, joint, cell_m)
    log_rho = np.log(np.maximum(spectral["rho"], LEAST_M))
    excess = excess_power(law_terms(power, log_rho).sum(axis=0), power, log_rho)
    without = np.random.default_rng([draw.seed, 9]).random(len(truth)) < 0.5
    return [
        {
            "evidence": with_power(seen, known)[which],
            "rho": spectral["rho"][which],
            "joint": joint["rho"][which],
            "truth": truth[which],
            "noise_std": spectral["rho_noise_std"][which],
            "cell_m": np.full(which.sum(), cell_m),
        }
        for which, known in ((without, None), (~without, excess))
    ]


def fit(sample: Sample, seed: int) -> dict[str, Judge]:
    """The two networks, by their names."""
    x = sample["evidence"]
    scale = np.minimum(sample["cell_m"], SPREAD_M)
    off, gap = ((sample[name] - sample["rho"]) / scale for name in ("truth", "joint"))
    whole = networks.fitted(x, _student(off, gap, sample["noise_std"] / scale), OUTPUTS + 1, seed, HIDDEN)
    first = replace(whole, c=whole.c[:, :OUTPUTS], d=whole.d[:OUTPUTS])
    found = np.empty(len(x))
    for cell_m in np.unique(sample["cell_m"]):
        which = sample["cell_m"] == cell_m
        found[which] = combined(first(x[which]), sample["rho"][which], sample["joint"][which], float(cell_m))
    error = np.maximum(found, 0) - sample["truth"]
    loss = networks.likelihood(error, sample["noise_std"], np.full(len(x), 1 / len(x)))
    return {"auto": first, "auto.std": networks.fitted(x, loss, 1, seed, HIDDEN)}


def _student(off: Floats, gap: Floats, noise: Floats) -> networks.Loss:
    """Negative log likelihood of what `combined` leaves of `off` (U,), its variance noise^2 + exp(output)."""

    def loss(outputs: Floats) -> tuple[float, Floats]:
        turn = np.clip(outputs[:, 0], -5, 5)
        share = 0.5 * (1 + np.tanh(outputs[:, 1] / 2))
        extra = np.exp(np.clip(outputs[:, 2], -14, 6))
        left = off - (1 - share) * np.sinh(turn) - share * gap
        variance = noise**2 + extra
        q = left * left / variance
        value = np.log(variance) + (FREEDOM + 1) * np.log1p(q / FREEDOM)
        pull = (FREEDOM + 1) / (FREEDOM + q)
        by_left = 2 * left / variance * pull
        slope = [
            -by_left * (1 - share) * np.cosh(turn),
            by_left * (np.sinh(turn) - gap) * share * (1 - share),
            (1 - q * pull) / variance * extra,
        ]
        return float(value.mean()), np.stack(slope, axis=1) / len(off)

    return loss
