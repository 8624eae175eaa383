"""rho = "auto": what delays, power and spreads say of a UE's distance, each weighed by what it is worth.

In a band too narrow to part a city's echoes from the direct path, the delay that a spectrum peaks at is that
of all paths together, later than the direct one's by the mean excess delay. How much later follows from what
else is seen: how fast coherence falls off over the band (the delay spread), how much of the power the beam
towards the UE leaves (the angle spread), where the joint method's first path is, and how strong the UE is for
its delay. A network of one hidden layer, fitted by `chachart train` to draws of the simulator's channels from
0.3 to 10 MHz, says from that where between and before both delays the direct path is; another how far off
that may be. How power falls with distance is learnt as UEs come by, from their delays (a regression of
log rho on log power), and no scale has to be known for it.

UEs whose position is known correct what is left, by recursive least squares: of log(true rho / rho) on a
constant, on the excess of power, on log rho and on the spread of delays, with coefficients that start at 0
and are believed to stay near it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from chachart.node.estimation.covariance import Bank
from chachart.node.estimation.judge import inflated, judge
from chachart.node.estimation.locator import Columns
from chachart.node.estimation.state import Slots, SlotState

Floats = NDArray[np.float64]

SPREAD_M: Final = 100.0
"""Corrections are in units of a resolution cell, but no more than this, about a city's delay spread."""
LEAST_M: Final = 10.0
"""Of ranges that logarithms are taken of."""
ENOUGH_UES: Final = 64
"""From so many UEs on, how power falls with distance is taken to be known."""
FARTHEST: Final = 2.0
"""Of log rho: so far, at most, does power seem too large or too small for the delay."""
OUTPUTS: Final = 2
"""Of the network: inverse hyperbolic sine of the correction, log odds of the joint method's path."""
BELIEF: Final = (0.1, 0.3, 0.1, 0.1)
"""Deviations of the coefficients that known positions correct, before any is known."""
EXPECTED_UES: Final = 50.0
"""So many UEs with a known position are worth as much as what is told of deviations without them."""
LEAST_DOUBT: Final = 0.02
"""Of log rho: no known position teaches more than that."""
TYPICAL_M: Final = 300.0
LOSS: Final = 5
"""Which column of the evidence tells how far coherence has fallen off over a quarter of the band."""


def evidence(spectral: Columns, joint: Columns, cell_m: float) -> tuple[Floats, Floats]:
    """What is seen of UEs beside their power: (U, F), and log signal power (U,).

    Parameters
    ----------
    spectral, joint
        What the two locators say: of Bartlett's range and its evidence, and of the joint method's path.
    cell_m
        Range resolution.
    """
    scale = min(cell_m, SPREAD_M)
    seen = spectral["rho_evidence"]
    total = spectral["power"] + spectral["noise"]
    power = np.log(total) - np.logaddexp(0, -seen[:, 1])
    rho, other = spectral["rho"], joint["rho"]
    std = joint.get("rho_noise_std", joint["rho_std"])
    columns = [
        _share(1 - spectral["power"] / np.exp(power)),
        np.arcsinh((other - rho) / scale),
        np.log(std / scale),
        _share(joint["power"] / (joint["power"] + joint["noise"])),
        np.log(rho / scale + 0.01),
        np.full(len(rho), np.log(scale)),
        np.log(np.maximum(rho, LEAST_M)),
    ]
    return np.concatenate([seen, np.stack(columns, axis=1)], axis=1), power


def with_power(seen: Floats, excess: Floats | None) -> Floats:
    """Evidence (U, F + 2) with `excess_power` (U,), or None where that is not known."""
    known = np.full(len(seen), float(excess is not None))
    return np.column_stack([seen, np.zeros(len(seen)) if excess is None else excess, known])


def combined(outputs: Floats, rho: Floats, other: Floats, cell_m: float) -> Floats:
    """Distances (U,) of the network's outputs (U, 2), of Bartlett's range and of the joint method's."""
    share = 0.5 * (1 + np.tanh(outputs[:, 1] / 2))
    shift = min(cell_m, SPREAD_M) * np.sinh(np.clip(outputs[:, 0], -5, 5))
    between: Floats = rho + (1 - share) * shift + share * (other - rho)
    return between


class RangeFusion(SlotState):
    """Distances of a block's UEs, and what is learnt across UEs.

    Parameters
    ----------
    cell_m, rho_max_m
        Range resolution, and the farthest range.
    echoes
        Whether there may be any; without, Bartlett's range stays what it is.
    """

    SHARED = ("_law", "_information", "_sum", "_errors")

    def __init__(self, cell_m: float, rho_max_m: float, echoes: bool) -> None:
        self.cell_m, self.rho_max_m, self._echoes = cell_m, rho_max_m, echoes
        self._law = np.zeros(5)
        self._information = np.zeros((len(BELIEF), len(BELIEF)))
        self._sum = np.zeros(len(BELIEF))
        self._errors = np.zeros(2)  # sum of squares by expected ones, and their number
        self._point = Bank((2,), np.float64)  # log power, log rho; log rho is 0 before the first
        self._lesson = Bank((len(BELIEF) + 2,), np.float64)  # terms, log error, its weight or 0
        super().__init__(point=self._point, lesson=self._lesson)

    def ranges(self, slots: Slots, spectral: Columns, joint: Columns, known_rho: Floats) -> Columns:
        """rho, rho_std and p_direct (U,) of UEs, of which `known_rho` (U,) is known or NaN."""
        rho, cell = spectral["rho"], self.cell_m
        if not self._echoes:
            return {name: spectral[name] for name in ("rho", "rho_std", "p_direct")}
        seen, power = evidence(spectral, joint, cell)
        log_rho = np.log(np.maximum(rho, LEAST_M))
        self._learn_law(slots, power, log_rho)
        excess = excess_power(self._law, power, log_rho)
        full = with_power(seen, excess)
        first = combined(judge("auto", OUTPUTS)(full), rho, joint["rho"], cell)
        first = np.clip(first, 0, self.rho_max_m)
        noise = spectral["rho_noise_std"]
        std = np.minimum(inflated(noise, judge("auto.std", 1)(full)[:, 0]), self.rho_max_m / np.sqrt(12))
        terms = np.stack(
            [
                np.ones(len(rho)),
                full[:, -2],
                np.log(np.maximum(first, LEAST_M) / TYPICAL_M),
                np.maximum(seen[:, LOSS] + 3, 0),
            ],
            axis=1,
        )
        relative = std / np.maximum(first, LEAST_M)
        error = np.log(np.maximum(known_rho, LEAST_M) / np.maximum(first, LEAST_M))
        self._learn(slots, terms, error, relative)
        lesson, left = self._lessons()
        final = np.clip(first * np.exp(terms @ lesson), 0, self.rho_max_m)
        std = std * left
        return {"rho": final, "rho_std": std, "p_direct": erf(cell / 2 / std / np.sqrt(2))}

    def _learn_law(self, slots: Slots, power: Floats, log_rho: Floats) -> None:
        """Take power and delay of UEs in place of what was seen of them before."""
        told = np.isfinite(power + log_rho)
        slots, rows = slots[told], self._point.rows
        old = rows[slots]
        before = old[old[:, 1] != 0]
        self._law += law_terms(power[told], log_rho[told]).sum(axis=0)
        self._law -= law_terms(before[:, 0], before[:, 1]).sum(axis=0)
        rows[slots] = np.stack([power[told], log_rho[told]], axis=1)

    def _learn(self, slots: Slots, terms: Floats, error: Floats, relative: Floats) -> None:
        """Take errors (U,) of log rho where positions are known, in place of what these UEs taught before."""
        known = np.flatnonzero(np.isfinite(error) & np.isfinite(terms).all(axis=1))
        if not len(known):
            return
        weight = 1 / (relative[known] ** 2 + LEAST_DOUBT**2)
        fresh = np.column_stack([terms[known], error[known], weight])
        rows = self._lesson.rows
        for sign, lessons in ((1, fresh), (-1, rows[slots[known]])):
            x, y, w = lessons[:, : len(BELIEF)], lessons[:, -2], sign * lessons[:, -1]
            self._information += (x * w[:, None]).T @ x
            self._sum += (x * w[:, None]).T @ y
            self._errors += (w @ (y * y), sign * np.count_nonzero(w))
        rows[slots[known]] = fresh

    def _lessons(self) -> tuple[Floats, float]:
        """Coefficients of the correction of log rho, and the deviations that are left, by those expected."""
        prior = np.diag(1 / np.square(BELIEF))
        x: Floats = np.linalg.solve(prior + self._information, self._sum).astype(np.float64)
        left = float(self._errors[0] - 2 * x @ self._sum + x @ self._information @ x)
        return x, float(np.sqrt((EXPECTED_UES + max(left, 0.0)) / (EXPECTED_UES + self._errors[1])))


def law_terms(power: Floats, log_rho: Floats) -> Floats:
    """1, x, x x, y, x y of log power x and log rho y, (U, 5)."""
    return np.stack([np.ones_like(power), power, power * power, log_rho, power * log_rho], axis=1)


def excess_power(law: Floats, power: Floats, log_rho: Floats) -> Floats | None:
    """How much larger log rho (U,) is for the power than for the delay; None while few UEs are known.

    Parameters
    ----------
    law
        Sum of `law_terms` of all UEs, for the regression of log rho on log power.
    """
    n, x, xx, y, xy = law
    spread = xx - x * x / max(n, 1)
    if n < ENOUGH_UES or spread < 1e-6 * n:
        return None
    slope = (xy - x * y / n) / spread
    excess: Floats = np.clip(slope * (power - x / n) + y / n - log_rho, -FARTHEST, FARTHEST)
    return excess


def _share(share: Floats) -> Floats:
    logarithm: Floats = np.log(np.clip(share, 1e-4, 10.0))
    return logarithm
