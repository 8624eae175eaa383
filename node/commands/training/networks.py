"""Networks of one hidden layer, fitted by their likelihood."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from chachart.node.estimation.judge import FARTHEST, Judge

Floats = NDArray[np.float64]
Loss = Callable[[Floats], tuple[float, Floats]]
"""Of outputs (U, O): its mean, and its gradient (U, O)."""

HIDDEN = 16
STEPS = 200
DECAY = 1e-4


def fitted(evidence: Floats, loss: Loss, outputs: int, seed: int, hidden: int = HIDDEN) -> Judge:
    """The network (F inputs, `outputs`) of least loss on evidence (U, F), by L-BFGS from a random start."""
    mean, scale = evidence.mean(axis=0), evidence.std(axis=0) + 1e-3
    x = np.clip((evidence - mean) / scale, -FARTHEST, FARTHEST)
    rng = np.random.default_rng(seed)
    shapes = [(x.shape[1], hidden), (hidden,), (hidden, outputs), (outputs,)]
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    start = np.zeros(ends[-1])
    start[: ends[0]] = rng.standard_normal(ends[0]) / np.sqrt(x.shape[1])
    start[ends[1] : ends[2]] = 0.1 * rng.standard_normal(ends[2] - ends[1])

    def parts(w: Floats) -> list[Floats]:
        pieces = np.split(w, ends[:-1])
        return [piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True)]

    def objective(w: Floats) -> tuple[float, Floats]:
        a, b, c, d = parts(w)
        layer = np.tanh(x @ a + b)
        value, slope = loss(layer @ c + d)
        back = (slope @ c.T) * (1 - layer * layer)
        gradient = [x.T @ back, back.sum(axis=0), layer.T @ slope, slope.sum(axis=0)]
        value += DECAY * float((a * a).sum() + (c * c).sum())
        gradient[0], gradient[2] = gradient[0] + 2 * DECAY * a, gradient[2] + 2 * DECAY * c
        return value, np.concatenate([g.ravel() for g in gradient])

    found: Any = minimize(objective, start, jac=True, method="L-BFGS-B", options={"maxiter": STEPS})
    return Judge(mean, scale, *parts(found.x))


def likelihood(error: Floats, std: Floats, weight: Floats) -> Loss:
    """Of errors (U,) that are Gaussian with the variance std^2 (1 + exp(y)), negative logarithm."""
    ratio = np.minimum((error / std) ** 2, 1e12)

    def loss(outputs: Floats) -> tuple[float, Floats]:
        y = outputs[:, 0]
        growth = np.logaddexp(0, y)
        q = ratio * np.exp(-growth)
        slope = weight * (1 - q) * 0.5 * (1 + np.tanh(y / 2))
        return float(weight @ (growth + q)), slope[:, None]

    return loss


def logistic(truth: NDArray[np.bool_], weight: Floats) -> Loss:
    """Of (U,) outcomes whose log odds are the output, negative logarithm."""

    def loss(outputs: Floats) -> tuple[float, Floats]:
        y = outputs[:, 0]
        slope = weight * (0.5 * (1 + np.tanh(y / 2)) - truth)
        return float(weight @ (np.logaddexp(0, y) - truth * y)), slope[:, None]

    return loss


def together(*losses: Loss) -> Loss:
    """The sum of losses, each of one output."""

    def loss(outputs: Floats) -> tuple[float, Floats]:
        found = [one(outputs[:, i : i + 1]) for i, one in enumerate(losses)]
        return sum(value for value, _ in found), np.concatenate([slope for _, slope in found], axis=1)

    return loss
