"""What came later counts too: Rauch, Tung and Striebel's smoother, over a fixed lag or a whole recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.state import Slots, SlotState
from chachart.node.estimation.tracking.mixture import merged
from chachart.node.estimation.tracking.motion import Floats, Motions


@dataclass(frozen=True)
class Past:
    """Filtered tracks of U UEs at T times, the latest last; those before `first` (U,) do not count.

    Attributes
    ----------
    time_ns
        (T, U).
    state, covariance
        (T, U, 4) and (T, U, 4, 4).
    model
        Probabilities (T, U, J) of the models that led to each state.
    """

    time_ns: NDArray[np.int64]
    state: Floats
    covariance: Floats
    model: Floats
    first: NDArray[np.intp]


class History(SlotState):
    """The last `lag` + 1 states of each slot; nothing without a lag."""

    BY_SLOT = ("_count", "_time", "_state", "_covariance", "_model")

    def __init__(self, models: int, lag: int) -> None:
        super().__init__()
        self.lag = lag
        depth = lag + 1 if lag else 0
        self._count = np.zeros(0, np.int64)
        self._time = np.zeros((0, depth), np.int64)
        self._state = np.zeros((0, depth, 4))
        self._covariance = np.zeros((0, depth, 4, 4))
        self._model = np.zeros((0, depth, models))

    def take(
        self, slots: Slots, time_ns: NDArray[np.int64], state: Floats, covariance: Floats, model: Floats
    ) -> None:
        """Add the newest state of each of `slots`."""
        if not self.lag:
            return
        news = (time_ns, state, covariance, model)
        for rows, new in zip((self._time, self._state, self._covariance, self._model), news, strict=True):
            rows[slots, :-1] = rows[slots, 1:]
            rows[slots, -1] = new
        self._count[slots] += 1

    def of(self, slots: Slots) -> Past:
        """What is kept of `slots`."""
        depth = self.lag + 1
        return Past(
            self._time[slots].T,
            self._state[slots].swapaxes(0, 1),
            self._covariance[slots].swapaxes(0, 1),
            self._model[slots].swapaxes(0, 1),
            depth - np.minimum(self._count[slots], depth).astype(np.intp),
        )


def smoothed(past: Past, motions: Motions) -> tuple[Floats, Floats]:
    """States (T, U, 4) and covariances (T, U, 4, 4) given everything up to the end.

    Between two times the models are mixed as the filter found them afterwards. (Rauch, Tung, Striebel,
    AIAA J. 3(8), 1965, eq. 3.30-3.32.)
    """
    state, covariance = past.state.copy(), past.covariance.copy()
    for i in range(len(state) - 2, -1, -1):
        dt = np.where(past.first <= i, past.time_ns[i + 1] - past.time_ns[i], 0) / 1e9
        weight = past.model[i + 1]
        f = motions.transition(dt)
        ahead = np.einsum("ujde,ue->ujd", f, past.state[i])
        around = f @ past.covariance[i][:, None] @ f.swapaxes(-1, -2) + motions.noise(dt)
        mean, spread = merged(ahead, around, weight)
        cross = past.covariance[i] @ np.einsum("uj,ujde->ued", weight, f)
        # A model that draws velocities afresh, or none of all, leaves directions in which nothing is known.
        gain = np.where((past.first <= i)[:, None, None], cross @ np.linalg.pinv(spread, hermitian=True), 0.0)
        state[i] += np.einsum("ude,ue->ud", gain, state[i + 1] - mean)
        covariance[i] += gain @ (covariance[i + 1] - spread) @ gain.swapaxes(-1, -2)
    return state, covariance


class Logbook:
    """Filtered tracks of a whole recording, to be smoothed at its end."""

    def __init__(self) -> None:
        self._ue: list[NDArray[np.uint64]] = []
        self._rest: list[tuple[NDArray[np.int64], Floats, Floats, Floats]] = []

    def add(
        self,
        ue: NDArray[np.uint64],
        time_ns: NDArray[np.int64],
        state: Floats,
        covariance: Floats,
        model: Floats,
    ) -> None:
        """The newest states of some UEs (U,), as `Past` has them."""
        self._ue.append(ue)
        self._rest.append((time_ns, state, covariance, model))

    def smoothed(self, motions: Motions) -> tuple[Floats, Floats]:
        """States (K, 4) and covariances (K, 4, 4) of all that was added, in that order."""
        ue = np.concatenate(self._ue)
        time_ns, state, covariance, model = (np.concatenate(part) for part in zip(*self._rest, strict=True))
        order = np.lexsort((time_ns, ue))
        _, column, count = np.unique(ue[order], return_inverse=True, return_counts=True)
        depth = int(count.max())
        first = depth - count
        starts = np.cumsum(count) - count
        row = np.arange(len(ue)) - starts[column] + first[column]
        shape = (depth, len(count))
        past = Past(
            np.zeros(shape, np.int64),
            np.zeros((*shape, 4)),
            np.tile(np.eye(4), (*shape, 1, 1)),
            np.full((*shape, len(motions)), 1 / len(motions)),
            first.astype(np.intp),
        )
        for rows, values in (
            (past.time_ns, time_ns),
            (past.state, state),
            (past.covariance, covariance),
            (past.model, model),
        ):
            rows[row, column] = values[order]
        found, around = smoothed(past, motions)
        back = np.argsort(order)
        return found[row, column][back], around[row, column][back]
