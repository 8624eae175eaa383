"""Tracks of many UEs at once, each fed with one set of alternatives at a time.

A second track of each UE, the rival, starts wherever the first one has missed what was seen, and takes its
place once what has been seen since speaks for it: so a track that has followed an echo comes back. Evidence
within `CORRELATED_S` counts once, since echoes stay for a while.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.state import Slots, SlotState
from chachart.node.estimation.tracking.mixture import Beliefs, Sightings, predicted, updated
from chachart.node.estimation.tracking.motion import MODELS, Floats, Motion, Motions
from chachart.node.estimation.tracking.smoother import History, smoothed

ELSEWHERE = 5e-3
"""What seeing something else is worth, by m^2: echoes are within some ten metres."""
CORRELATED_S = 0.5
"""Evidence of so long counts as one observation."""
RIVAL = float(np.log(1e-4))
"""Log evidence that a new rival begins with, ..."""
HOPELESS = RIVAL - 20
"""... and below which it makes way for another."""
MISSED = 0.5
"""Probability of having seen something else that makes a miss."""
MOST_LATE_S = 5.0
"""Observations older than the track by more than this are of no use."""
LONGEST_GAP_S = 60.0
"""After a longer silence a track starts afresh."""


@dataclass(frozen=True)
class Tracked:
    """Tracks of U UEs.

    Attributes
    ----------
    state, covariance
        x, y, vx, vy (U, 4) in metres and m/s, and their covariances (U, 4, 4).
    missed
        Probability (U,) that what was seen last was something else.
    time_ns
        When that is (U,): the time of the latest observation, or with a lag of an earlier one.
    """

    state: Floats
    covariance: Floats
    missed: Floats
    time_ns: NDArray[np.int64]


class Tracker(SlotState):
    """Follows the UEs in slots.

    Parameters
    ----------
    motion
        How they move: `static`, `walk` (or standing), `drive` (or either).
    lag
        How many observations later a position is told: what came after it then counts as well.

    Examples
    --------
    >>> tracker = Tracker("walk")
    >>> tracker.resize(1)
    >>> for i in range(50):
    ...     seen = Sightings.single(np.array([[0.14 * i, 0.0]]), 0.01 * np.eye(2)[None])
    ...     at = tracker.update(np.array([0]), np.array([i * 100_000_000]), seen)
    >>> np.round(at.state[0], 1).tolist()
    [6.9, 0.0, 1.4, 0.0]
    """

    BY_SLOT = ("_time", "_mean", "_covariance", "_model", "_score", "_missed", "_seen")

    def __init__(self, motion: Motion = "drive", lag: int = 0) -> None:
        self._motions = Motions(MODELS[motion])
        models = len(self._motions)
        self._time = np.zeros(0, np.int64)
        self._mean = np.zeros((0, 2, models, 4))
        self._covariance = np.zeros((0, 2, models, 4, 4))
        self._model = np.zeros((0, 2, models))
        self._score = np.zeros((0, 2))
        self._missed = np.zeros(0)
        self._seen = np.zeros(0, np.int64)
        self.history = History(models, lag)
        super().__init__(history=self.history)

    @property
    def motions(self) -> Motions:
        """The models that are mixed."""
        return self._motions

    def update(self, slots: Slots, time_ns: NDArray[np.int64], seen: Sightings) -> Tracked:
        """Take one observation of each UE in `slots` (U,), no slot twice, of the times `time_ns` (U,).

        Observations may come late and out of order; what is older than `MOST_LATE_S` is ignored.
        """
        gap = (time_ns - self._time[slots]) / 1e9
        fresh = (self._seen[slots] == 0) | (gap > LONGEST_GAP_S)
        useful = ~fresh & (gap >= -MOST_LATE_S)
        self._begin(slots[fresh], seen.take(fresh))
        self._go_on(slots[useful], gap[useful], seen.take(useful))
        self._seen[slots] += 1
        self._time[slots] = np.where(fresh, time_ns, np.maximum(time_ns, self._time[slots]))
        state, covariance = self._beliefs(slots, 0).merged()
        taken = fresh | (useful & (gap > 0))
        self.history.take(
            slots[taken],
            self._time[slots[taken]],
            state[taken],
            covariance[taken],
            self._model[slots[taken], 0],
        )
        if not self.history.lag:
            return Tracked(state, covariance, self._missed[slots], self._time[slots])
        past = self.history.of(slots)
        before, around = smoothed(past, self._motions)
        first = past.first
        users = np.arange(len(slots))
        return Tracked(
            before[first, users], around[first, users], self._missed[slots], past.time_ns[first, users]
        )

    def models(self, slots: Slots) -> Floats:
        """Probabilities (U, J) of the models that the tracks of `slots` follow."""
        models: Floats = self._model[slots, 0]
        return models

    def expected(self, slots: Slots, time_ns: NDArray[np.int64]) -> Floats:
        """Where the UEs in `slots` should be at `time_ns`, (U, 2); NaN for those not seen yet."""
        state, _ = self._beliefs(slots, 0).merged()
        gap = np.clip((time_ns - self._time[slots]) / 1e9, -MOST_LATE_S, LONGEST_GAP_S)
        ahead: Floats = state[:, :2] + gap[:, None] * state[:, 2:]
        ahead[self._seen[slots] == 0] = np.nan
        return ahead

    def _beliefs(self, slots: Slots, which: int) -> Beliefs:
        return Beliefs(self._mean[slots, which], self._covariance[slots, which], self._model[slots, which])

    def _keep(self, slots: Slots, which: int, beliefs: Beliefs) -> None:
        self._mean[slots, which] = beliefs.mean
        self._covariance[slots, which] = beliefs.covariance
        self._model[slots, which] = beliefs.model

    def _begin(self, slots: Slots, seen: Sightings) -> None:
        start = self._start(seen)
        for which in (0, 1):
            self._keep(slots, which, start)
        self._score[slots] = [0.0, -np.inf]
        self._missed[slots] = seen.none

    def _start(self, seen: Sightings) -> Beliefs:
        """A track at the most likely alternative."""
        models = len(self._motions)
        users = np.arange(len(seen.none))
        best = seen.log_weights.argmax(axis=1)
        mean = np.zeros((len(users), models, 4))
        mean[..., :2] = seen.points[users, best][:, None]
        covariance = np.zeros((len(users), models, 4, 4))
        covariance[..., :2, :2] = seen.covariances[users, best][:, None]
        covariance[..., 2, 2] = covariance[..., 3, 3] = self._motions.first_variance
        return Beliefs(mean, covariance, np.full((len(users), models), 1 / models))

    def _go_on(self, slots: Slots, gap: Floats, seen: Sightings) -> None:
        if not len(slots):
            return
        step = np.maximum(gap, 0.0)
        late = np.maximum(-gap, 0.0)
        weight = np.minimum(1.0, np.abs(gap) / CORRELATED_S)
        score = self._score[slots]
        missed = np.empty((len(slots), 2))
        for which in (0, 1):
            prior = predicted(self._beliefs(slots, which), self._motions, step)
            beliefs, evidence, missed[:, which] = updated(prior, seen.brought_forward(prior, late), ELSEWHERE)
            self._keep(slots, which, beliefs)
            score[:, which] += weight * evidence
        worse = score[:, 1] > score[:, 0]
        for kept in (self._mean, self._covariance, self._model):
            kept[slots[worse]] = kept[slots[worse], ::-1]
        score[worse], missed[worse] = score[worse, ::-1], missed[worse, ::-1]
        score -= score[:, :1]
        off = missed[:, 0] > MISSED
        again = off & (missed[:, 1] > MISSED) | off & (score[:, 1] < HOPELESS)
        self._keep(slots[again], 1, self._start(seen.take(again)))
        score[again, 1] = RIVAL
        self._score[slots] = score
        self._missed[slots] = missed[:, 0]
