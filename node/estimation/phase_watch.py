"""Do frames keep the phase of those that they are averaged with?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.covariance import Grouping
from chachart.node.estimation.periodogram import Csi, energy
from chachart.node.estimation.state import Slots, SlotState

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class PhaseWatch(SlotState):
    """Which UEs' frames keep their phase, and which have lost it or found it again.

    Oscillators that start anew with every frame turn its phase at random, and so does a UE that moves by a
    wavelength between frames, the phases of its echoes even against one another. The mean over frames then
    shrinks. Watched is the cosine of arg(z), z = <sum of the UE's other frames, frame>, where |z| is too
    large to be noise: z of independent noise has the mean square |a|^2 |b|^2 / N. What is seen of a UE
    decides for it alone; while little is, it is believed to be as most UEs are.

    Parameters
    ----------
    decay
        Of the sums.
    """

    EVERY = 8
    """Of a block, every so many frames are looked at, and all frames of UEs whose phases are random."""
    SIGNIFICANCE = 9.0
    """|z|^2 over its mean square for noise: then arg(z) is good to 0.25 rad, its cosine to 3 %."""
    MEMORY = 16.0
    """Significant frames of a UE remembered."""
    PRIOR = 8.0
    """So many make up what is believed of a UE; those that it lacks are taken to be as most UEs' are."""
    MEMORY_OF_ALL, PRIOR_OF_ALL = 256.0, 8.0
    """Significant frames of all UEs remembered, and what belief in their steadiness weighs at first."""
    MOST = 0.3, 0.7
    """Mean cosines of all UEs up to which most of them are random, and from which most are steady."""
    STEADY = 0.9
    """Least mean cosine: the loss of signal is then below 1 dB."""
    STEADY_AGAIN = 0.95
    """And where phases were random before."""
    FADING = 15 / 17
    """Weight of a frame relative to the next while phases are random: the sum is then of the last 16 frames,
    so that it shows when they become steady."""

    BY_SLOT = ("_cosines", "_count")
    SHARED = ("_all_cosines", "_all_count", "_blocks")

    def __init__(self, decay: float) -> None:
        super().__init__()
        self._decay = decay
        self._cosines, self._count = np.zeros(0), np.zeros(0)
        self._all_cosines = self._all_count = self.PRIOR_OF_ALL
        self._blocks = 0

    def random(self, slots: Slots, was: Mask) -> Mask:
        """Whose phases are random (U,), of UEs of which that `was` so (U,)."""
        count = self._count[slots]
        lacking = np.maximum(self.PRIOR - count, 0)
        low, high = self.MOST
        others = min(max((self._all_cosines / self._all_count - low) / (high - low), 0.0), 1.0)
        cosines = self._cosines[slots] + lacking * others
        least = np.where(was, self.STEADY_AGAIN, self.STEADY)
        found: Mask = cosines < least * (count + lacking)
        return found

    def fading(self, frames: NDArray[np.intp]) -> Floats:
        """What to multiply sums by before `frames` (U,) more are added, where phases are random."""
        return np.power(min(self.FADING / self._decay, 1.0) if self._decay else 1.0, frames)

    def look(self, group: Grouping, csi: Csi, rows: Csi, random: Mask) -> None:
        """Look at some of a block's frames (K, N_R, N_S).

        Parameters
        ----------
        rows
            Sums by slot that already hold them.
        random
            (U,) UEs to look at closely.
        """
        at = np.arange(self._blocks % min(self.EVERY, len(csi)), len(csi), self.EVERY)
        self._blocks += 1
        of = np.repeat(np.arange(len(group)), group.counts)
        sampled = np.ones(len(at), np.bool_)
        if random.any():
            closely = random[of]
            closely[at] = False
            also = np.flatnonzero(closely)
            at, sampled = np.concatenate([at, also]), np.concatenate([sampled, np.zeros(len(also), np.bool_)])
        ue = of[at]
        follow = (group.starts + group.counts)[ue] - 1 - at
        frames = csi[group.order[at]].reshape(len(ue), -1)
        others = rows[group.slots[ue]].reshape(len(ue), -1)
        others -= np.power(self._decay, follow).astype(np.float32)[:, None] * frames
        z = np.einsum("ki,ki->k", others.conj(), frames)
        size = np.abs(z).astype(np.float64)
        noise = energy(others) * energy(frames) / frames.shape[1]
        sure = size**2 > self.SIGNIFICANCE * noise
        cosine = z.real[sure] / size[sure]
        self._remember(group.slots, ue[sure], cosine)
        cosine = cosine[sampled[sure]]
        keep = np.exp(-len(cosine) / self.MEMORY_OF_ALL)
        self._all_cosines = keep * self._all_cosines + float(cosine.sum())
        self._all_count = keep * self._all_count + len(cosine)

    def _remember(self, slots: Slots, ue: NDArray[np.intp], cosine: NDArray[np.floating]) -> None:
        count = np.bincount(ue, minlength=len(slots))
        seen = np.flatnonzero(count)
        if not len(seen):
            return
        keep = np.exp(-count[seen] / self.MEMORY)
        total = np.bincount(ue, cosine, len(slots))[seen]
        self._cosines[slots[seen]] = keep * self._cosines[slots[seen]] + total
        self._count[slots[seen]] = keep * self._count[slots[seen]] + count[seen]
