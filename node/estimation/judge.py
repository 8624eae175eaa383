"""How far an estimate may be off, from the evidence on it: small networks that `chachart train` has fitted.

In multipath the error of an estimate is not what noise does to a lone path: echoes that are not resolved pull
it, and what passes for the direct path may not be it. How much follows from what can be seen (the evidence:
`AxisEvidence` and `DirectPath.find`), but by no formula that is worth having: on draws of the simulator's
channels, from one path to none in sight, a network of one hidden layer is fitted to the errors by Gaussian
likelihood, so that errors over deviations have a variance of 1.
"""

from __future__ import annotations

import json
import pkgutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FILE: Final = "trained.json"
"""Beside this module."""
FARTHEST: Final = 4.0
"""Standard deviations of the training's evidence beyond which evidence counts as that far."""

_unjudged = ContextVar("unjudged", default=False)


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """y = tanh((x - mean) / scale A + b) C + d, for evidence x.

    Attributes
    ----------
    mean, scale
        (F,) of the evidence that it was fitted to.
    a, b, c, d
        (F, H), (H,), (H, O), (O,).
    """

    mean: Floats
    scale: Floats
    a: Floats
    b: Floats
    c: Floats
    d: Floats

    def __call__(self, evidence: Floats) -> Floats:
        """(U, O) of evidence (U, F)."""
        x = np.clip((evidence - self.mean) / self.scale, -FARTHEST, FARTHEST)
        y: Floats = np.tanh(x @ self.a + self.b) @ self.c + self.d
        return y

    def as_dict(self) -> dict[str, Any]:
        """Plain values, to five digits."""
        return {name: _rounded(getattr(self, name)) for name in ("mean", "scale", "a", "b", "c", "d")}


def inflated(std: Floats, y: Floats) -> Floats:
    """Deviations (U,) of noise alone times what an output (U,) says: the variance grows by 1 + exp(y)."""
    wider: Floats = std * np.exp(np.logaddexp(0, y) / 2)
    return wider


def probability(y: Floats) -> Floats:
    """Of an output (U,), by the logistic function."""
    return 0.5 * (1 + np.tanh(y / 2))


@lru_cache(maxsize=1)
def shipped() -> dict[str, Any]:
    """What the file holds, by the names of the networks."""
    content = pkgutil.get_data(__package__, FILE)
    trained: dict[str, Any] = json.loads(content or b"{}")
    return trained


@lru_cache(maxsize=32)
def _judge(name: str) -> Judge:
    return Judge(**{key: np.array(values, np.float64) for key, values in shipped()[name].items()})


def judge(name: str, outputs: int) -> Callable[[Floats], Floats]:
    """The one that was trained for a method on an axis, or for joint."""
    return (lambda evidence: np.zeros((len(evidence), outputs))) if _unjudged.get() else _judge(name)


def alone(evidence: Floats) -> Floats:
    """What a judge of joint says where noise is all there is: (U, 3)."""
    return np.tile([-np.inf, -np.inf, np.inf], (len(evidence), 1))


@contextmanager
def unjudged() -> Iterator[None]:
    """Estimates in here are not judged: evidence is collected for judges yet to be trained."""
    token = _unjudged.set(True)
    try:
        yield
    finally:
        _unjudged.reset(token)


def _rounded(values: Floats) -> Any:
    return np.array([float(f"{v:.5g}") for v in values.ravel()]).reshape(values.shape).tolist()
