"""Ranging by amplitude: inverse square root (ISQ) and logarithmic regression (LR).

Both turn s, the sum over the antennas of |h|, into a range. Noise lifts |h|, the more so the farther the UE,
so what |h| stands for is a choice: "debiased" takes the noise power off the mean power, "coherent" averages
h over frames first (only sound for UEs that stand still, and with frames of equal phase), "noisy" is the
plain mean of |h|.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.covariance import Bank, Grouping
from chachart.node.estimation.state import Slots, SlotState

Floats = NDArray[np.float64]


class AmplitudeSum(SlotState):
    """s (U,) of a block's UEs, running over their frames.

    Parameters
    ----------
    kind
        "debiased", "coherent" or "noisy".
    antennas, live
        N_R, and how many of them count and are in the frames: s is made up for the others.
    decay
        Weight of a frame relative to the next one of its UE.
    """

    def __init__(self, kind: str, antennas: int, live: int, decay: float) -> None:
        self.kind, self.antennas, self.live = kind, antennas, live
        kept: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
            "debiased": ((0,), np.float32),
            "coherent": ((live,), np.complex64),
            "noisy": ((), np.float32),
        }
        self._bank = Bank(*kept[kind], decay)
        super().__init__(bank=self._bank)

    def of_frames(self, csi: NDArray[np.complex64]) -> NDArray[Any]:
        """What is kept of each frame (K, live, N_S): nothing, h of the first subcarrier, or mean |h|."""
        if self.kind == "debiased":
            return np.zeros((len(csi), 0), np.float32)
        if self.kind == "coherent":
            return csi[:, :, 0].copy()
        mean: NDArray[np.float32] = np.abs(csi).sum(axis=(1, 2)) / np.float32(csi.shape[2])
        return mean

    def take(self, group: Grouping, features: NDArray[Any]) -> NDArray[Any]:
        """Take what is kept of a block's frames; returns the sums of its UEs."""
        return features if self.kind == "debiased" else self._bank.add(group, features)

    def estimate(self, sums: NDArray[Any], weight: Floats, power: Floats) -> Floats:
        """s (U,) of a block's UEs.

        Parameters
        ----------
        sums
            Of `take`.
        weight
            (U,) sum of the weights of each UE's frames.
        power
            (U,) signal power per element without the noise.
        """
        if self.kind == "debiased":
            return self.antennas * np.sqrt(power)
        mean = np.abs(sums).astype(np.float64)
        total: Floats = mean.sum(axis=1) if self.kind == "coherent" else mean
        return total * (self.antennas / self.live) / weight


class PowerLaw(SlotState):
    """log(rho) = a x + b + scatter with x = log(s), by least squares: how far ranges by amplitude may be off.

    Amplitude falls with a power of the distance, and shadowing scatters its logarithm. A method that turns s
    into a range otherwise errs by what it differs from this law, and by the scatter. Shadows are common to
    what is close together: UEs that stand within `SHADOW_M` tell no more than one.
    """

    SHARED = ("_sums", "_places")

    SHADOW_M = 225.0
    """Side of a square as large as the area of one shadow: 2 pi times the square of the 90 m over which
    shadowing decorrelates in cities."""
    PLACES = 4096
    """Counters for places, which are told apart by a hash."""

    MOST_VARIANCE = 1.5
    """Of log(rho), where few points or a far one leave it unknown."""
    UNTRAINED = 0.4
    """Deviation of log(rho) where no position is known: what shadowing of 4 dB makes."""

    def __init__(self) -> None:
        super().__init__()
        self._sums = np.zeros(6)
        self._places = np.zeros(self.PLACES)

    def add(self, terms: Floats, position: NDArray[Any]) -> None:
        """Take sums of `terms` of points that come in less those of points that leave, (6,).

        `position` (U, 3) is where those that come in are.
        """
        self._sums += terms
        east, north = np.floor(position[:, :2].astype(np.float64) / self.SHADOW_M).astype(np.int64).T
        np.add.at(self._places, (east * 73_856_093 ^ north * 19_349_663) % self.PLACES, 1)

    def deviation(self, x: Floats, rho: Floats) -> Floats:
        """Root mean square error (U,) of ranges rho (U,) for the law at x (U,), lognormal about it."""
        a, b, scatter = regression(self._sums)
        if not np.isfinite(scatter):
            return rho * self.UNTRAINED
        n, sum_x, _, sum_xx, *_ = self._sums
        apart = max(min(float(np.count_nonzero(self._places)), n), 3.0)
        far = (1 + (x - sum_x / n) ** 2 / (sum_xx / n - (sum_x / n) ** 2)) / apart
        variance = scatter**2 * ((n - 2) / n * apart / (apart - 2)) * (1 + far)
        variance = np.minimum(variance, self.MOST_VARIANCE)
        mean = np.exp(a * x + b + variance / 2)
        deviation: Floats = np.hypot(mean * np.sqrt(np.expm1(variance)), rho - mean)
        return deviation


class Isq(SlotState):
    """rho = scale / sqrt(s); scale is 1 until a reference is known.

    With a reference (rho_0, s_0), scale = rho_0 sqrt(s_0). Otherwise it is the mean of rho sqrt(s) over all
    estimates of UEs whose position is known.
    """

    SHARED = ("_total", "_count")

    def __init__(self, reference: tuple[float, float] | None) -> None:
        self._law = PowerLaw()
        super().__init__(law=self._law)
        self._fixed = None if reference is None else reference[0] * np.sqrt(reference[1])
        self._total, self._count = 0.0, 0

    @property
    def relative(self) -> bool:
        """Whether there is no scale yet: ranges are then right but for a factor, the same for all UEs."""
        return self._fixed is None and not self._count

    @property
    def scale(self) -> float:
        """rho sqrt(s)."""
        if self._fixed is not None:
            return float(self._fixed)
        return self._total / self._count if self._count else 1.0

    def ranges(
        self, slots: Slots, s: Floats, known_rho: Floats, position: NDArray[Any]
    ) -> tuple[Floats, Floats]:
        """rho and its standard deviation: NaN without a scale, for then rho is no distance."""
        root, x = np.sqrt(s), np.log(s)
        known = np.isfinite(known_rho) & (known_rho > 0)
        self._total += float((known_rho[known] * root[known]).sum())
        self._count += int(known.sum())
        self._law.add(_terms(x[known], np.log(known_rho[known])).sum(axis=0), position[known])
        rho = self.scale / root
        if self._fixed is None and not self._count:
            return rho, np.full(len(s), np.nan)
        return rho, self._law.deviation(x, rho)


class Lr(SlotState):
    """rho = a log(s) + b, or log(rho) = a log(s) + b, by recursive least squares in information form.

    The first `train_ues` UEs whose position is known train it. Each contributes its latest (log s, rho):
    when it is seen again, its old contribution is taken off the sums and the new one added, so the fit is
    the exact least squares fit at any time. A UE that leaves keeps its contribution.
    """

    SHARED = ("_trained", "_sums")
    relative = False

    def __init__(self, train_ues: int, log_range: bool) -> None:
        self.train_ues, self.log_range = train_ues, log_range
        self._trained = 0
        self._sums = np.zeros(6)
        self._law = PowerLaw()
        self._of_slot = Bank((2,), np.float64)  # log s, rho; rho is 0 where it is not trained on
        super().__init__(of_slot=self._of_slot, law=self._law)

    def fit(self) -> tuple[float, float, float]:
        """a, b and the standard deviation of what they leave unexplained; NaN while there are too few UEs."""
        return regression(self._sums)

    def ranges(
        self, slots: Slots, s: Floats, known_rho: Floats, position: NDArray[Any]
    ) -> tuple[Floats, Floats]:
        """rho and its standard deviation; NaN before there is a fit."""
        x = np.log(s)
        self._train(slots, x, known_rho, position)
        a, b, _ = self.fit()
        y = a * x + b
        rho = np.exp(y) if self.log_range else np.maximum(y, 0.0)
        return rho, self._law.deviation(x, rho)

    def _train(self, slots: Slots, x: Floats, known_rho: Floats, position: NDArray[Any]) -> None:
        rows = self._of_slot.rows
        usable = np.isfinite(known_rho) & (known_rho > 0)
        trained = usable & (rows[slots, 1] > 0)
        fresh = np.flatnonzero(usable & ~trained)[: max(self.train_ues - self._trained, 0)]
        self._trained += len(fresh)
        again = np.flatnonzero(trained)
        use = np.concatenate([again, fresh])
        if not len(use):
            return
        old_x, old_rho = rows[slots[again]].T
        change = [
            _terms(x[use], known).sum(axis=0) - _terms(old_x, old).sum(axis=0)
            for known, old in ((np.log(known_rho[use]), np.log(old_rho)), (known_rho[use], old_rho))
        ]
        self._law.add(change[0], position[use])
        self._sums += change[0 if self.log_range else 1]
        rows[slots[use]] = np.stack([x[use], known_rho[use]], axis=1)


def regression(sums: Floats) -> tuple[float, float, float]:
    """a, b and residual deviation of y = a x + b from the sums of `_terms`; NaN while there are too few."""
    n, x, y, xx, xy, yy = sums
    spread = xx - x * x / n if n else 0.0
    if n < 2 or spread <= 1e-12 * xx:
        return np.nan, np.nan, np.nan
    a = (xy - x * y / n) / spread
    left = yy - y * y / n - a * (xy - x * y / n)
    return a, (y - a * x) / n, float(np.sqrt(max(left, 0.0) / (n - 2))) if n > 2 else np.nan


def _terms(x: Floats, y: Floats) -> Floats:
    """1, x, y, x x, x y, y y of points (U,), as (U, 6)."""
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def ranging(
    method: str, *, reference: tuple[float, float] | None, train_ues: int, log_range: bool
) -> Isq | Lr:
    """The named amplitude method."""
    return Isq(reference) if method == "isq" else Lr(train_ues, log_range)
