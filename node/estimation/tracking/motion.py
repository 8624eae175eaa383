"""How UEs move: models that an interacting-multiple-model filter mixes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Motion = Literal["static", "walk", "drive"]


@dataclass(frozen=True)
class Model:
    """Nearly constant velocity in the plane, or one of its limits.

    Parameters
    ----------
    name
        What moves like this.
    acceleration
        Spectral density of white acceleration, m^2/s^3.
    drift
        Spectral density of white velocity, m^2/s: what displaces a UE that stands.
    speed_m_s
        Standard deviation of each component of the velocity at first.
    keeps
        1: the velocity goes on; 0: it is drawn afresh with every step, from `speed_m_s`.
    """

    name: str
    acceleration: float
    drift: float
    speed_m_s: float
    keeps: float = 1.0


STATIC: Final = Model("static", 0.0, 1e-3, 0.0, keeps=0.0)
WALK: Final = Model("walk", 0.3, 0.0, 1.0)
DRIVE: Final = Model("drive", 10.0, 0.0, 12.0)
TURN: Final = Model("turn", 0.0, 0.0, 20.0, keeps=0.0)
"""A corner or a sudden start: where to is open."""

MODELS: Final[dict[Motion, tuple[Model, ...]]] = {
    "static": (STATIC,),
    "walk": (STATIC, WALK),
    "drive": (STATIC, WALK, DRIVE, TURN),
}
RESIDENCE_S: Final = 20.0
"""Mean time before a UE moves differently."""
TURN_SHARE: Final = 0.02
"""Probability of a turn from one frame to the next."""


class Motions:
    """The matrices of a set of models for steps of different lengths.

    Parameters
    ----------
    models
        In the order of the filter's second axis.
    """

    def __init__(self, models: tuple[Model, ...]) -> None:
        self.models = models
        self._acceleration = np.array([m.acceleration for m in models])
        self._drift = np.array([m.drift for m in models])
        self._speed2 = np.array([m.speed_m_s**2 for m in models])
        self._keeps = np.array([m.keeps for m in models])

    def __len__(self) -> int:
        return len(self.models)

    @property
    def first_variance(self) -> Floats:
        """Of each component of the velocity before anything is known, (J,)."""
        return self._speed2

    def transition(self, dt: Floats) -> Floats:
        """F (U, J, 4, 4) of states x, y, vx, vy over `dt` (U,) seconds."""
        f = np.zeros((len(dt), len(self), 4, 4))
        f[..., 0, 0] = f[..., 1, 1] = 1
        f[..., 0, 2] = f[..., 1, 3] = dt[:, None] * self._keeps
        f[..., 2, 2] = f[..., 3, 3] = self._keeps
        return f

    def noise(self, dt: Floats) -> Floats:
        """Q (U, J, 4, 4) over `dt` (U,) seconds."""
        q = np.zeros((len(dt), len(self), 4, 4))
        step = dt[:, None]
        fresh = (1 - self._keeps) * self._speed2
        place = self._acceleration * step**3 / 3 + self._drift * step + fresh * step**2
        cross = self._acceleration * step**2 / 2 + fresh * step
        speed = self._acceleration * step + fresh
        for i in (0, 1):
            q[..., i, i] = place
            q[..., i, i + 2] = q[..., i + 2, i] = cross
            q[..., i + 2, i + 2] = speed
        return q

    def switching(self, dt: Floats) -> Floats:
        """Probabilities (U, J, J) of model j after model i."""
        lasting = [i for i, m in enumerate(self.models) if m is not TURN]
        count = len(self)
        p = np.zeros((len(dt), count, count))
        leave = 1 - np.exp(-dt / RESIDENCE_S)
        for i in lasting:
            for j in lasting:
                p[:, i, j] = 1 - leave if i == j else leave / max(1, len(lasting) - 1)
        if len(lasting) == 1:
            p[:, lasting[0], lasting[0]] = 1
        for t in set(range(count)) - set(lasting):
            p[:, :, t] = 0
            p *= 1 - TURN_SHARE
            p[:, :, t] = TURN_SHARE
            p[:, t] = 0
            p[:, t, self.models.index(DRIVE)] = 1 - TURN_SHARE
            p[:, t, t] = TURN_SHARE
        return p
