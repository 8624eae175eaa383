"""theta and rho together: the direct path in the angle-delay spectrum of each UE's frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.covariance import Grouping, Weights
from chachart.node.estimation.direct_path import DirectPath
from chachart.node.estimation.locator import Columns, Features, Locator
from chachart.node.estimation.options import Options
from chachart.node.estimation.periodogram import CoherentSums, Csi, PowerSums, SpectrumState, energy
from chachart.node.estimation.state import Slots, SlotState

Floats = NDArray[np.float64]


class JointLocator(Locator):
    """The joint angle-delay method: `DirectPath` on averaged spectra.

    Averages the frames themselves while they keep their phase, which finds weak paths best, and their power
    spectra when they do not (see `PhaseWatch`). The change, once and for all UEs, takes over what has been
    averaged so far.

    Parameters
    ----------
    array, options
        As of `ChartEstimator`.
    """

    SHARED = ("_random",)

    def __init__(self, array: ArrayGeometry, options: Options) -> None:
        self._direct_path = DirectPath(array, options.rho_max_m)
        self._decay = options.decay
        self._weights = Weights(options.decay)
        periodogram = self._direct_path.periodogram
        self._sums = CoherentSums(periodogram, self._weights, options.decay)
        self._powers = PowerSums(periodogram, options.decay)
        self._random = int(options.phase == "random")
        self._watch = PhaseWatch()
        self._watched = options.phase == "auto"
        super().__init__(weights=self._weights, sums=self._sums, powers=self._powers, watch=self._watch)

    @property
    def coherent(self) -> bool:
        """Whether frames are averaged rather than their power spectra."""
        return not self._random

    @property
    def _state(self) -> SpectrumState:
        return self._powers if self._random else self._sums

    def features(self, csi: Csi) -> Features:
        """The frames (K, N_R, N_S), or their power spectra."""
        kept = self._state.features(csi)
        return Features(self._state.energy(kept), {"state": kept})

    def estimate(self, group: Grouping, features: Features, position: NDArray[np.float32]) -> Columns:
        """Take a block's frames and locate its UEs; `position` is of no use here."""
        _, frames = self._weights.add(group)
        self._state.take(group, features.kept["state"])
        if self._watched and self.coherent:
            self._watch.look(group, features.kept["state"], self._sums.bank.rows[group.slots], self._decay)
            if not self._watch.steady:
                known = self._weights.of(np.arange(len(self._sums.bank.rows)))[0] > 0
                self._powers.take_over(np.flatnonzero(known), self._sums)
                self._random = 1
        chunk = self._direct_path.periodogram.chunk
        pieces = [self._locate(group.slots[i : i + chunk]) for i in range(0, len(group), chunk)]
        at = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
        return at | {"snapshots": frames}

    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """theta_grid_rad, theta_spectrum, rho_grid_m, rho_spectrum: the maxima along the other axis."""
        slots = np.array([slot])
        if self._weights.of(slots)[1][0] == 0:
            return None
        angle, delay = self._direct_path.angle, self._direct_path.delay
        theta, rho = angle.points(points), delay.points(points)
        power = self._direct_path.periodogram.sampled(
            self._state.spectra(slots)[0][0], angle.u(theta), -delay.u(rho)
        )
        power /= power.max()
        return {
            "theta_grid_rad": theta,
            "theta_spectrum": power.max(axis=1),
            "rho_grid_m": rho,
            "rho_spectrum": power.max(axis=0),
        }

    def _locate(self, slots: Slots) -> Columns:
        """Where the UEs are, and their SNR; echoes count as noise, as they do on one axis."""
        power, looks, gain = self._state.spectra(slots)
        at = self._direct_path.find(power, looks)
        at["snr"] = 10 * np.log10(at["power"] / (at["noise"] + (gain - 1) * at["floor"]))
        return at


class PhaseWatch(SlotState):
    """Do frames keep the phase of those that they are averaged with?

    Oscillators that start anew with every frame turn its phase at random, and so does a UE that moves by a
    wavelength between frames, the phases of its echoes even against one another. The mean over frames then
    shrinks. Watched is, over all UEs, the cosine of arg(z), z = <sum of the UE's other frames, frame>, where
    |z| is too large to be noise: z of independent noise has the mean square |a|^2 |b|^2 / N.
    """

    EVERY = 8
    """Of a block, every so many frames are looked at."""
    SIGNIFICANCE = 9.0
    """|z|^2 over its mean square for noise: then arg(z) is good to 0.25 rad, its cosine to 3 %."""
    MEMORY = 256.0
    """Significant frames remembered; a quarter of it is what the belief in steadiness weighs at first."""
    STEADY = 0.9
    """Least mean cosine: the loss of signal is then below 1 dB."""

    SHARED = ("_cosines", "_count", "_blocks")

    def __init__(self) -> None:
        super().__init__()
        self._cosines = self._count = self.MEMORY / 4
        self._blocks = 0

    @property
    def steady(self) -> bool:
        """Whether frames do keep their phase."""
        return self._cosines >= self.STEADY * self._count

    def look(self, group: Grouping, csi: Csi, sums: Csi, decay: float) -> None:
        """Look at some of a block's frames (K, N_R, N_S); `sums` (U, N_R, N_S) already hold them."""
        every = slice(self._blocks % min(self.EVERY, len(csi)), None, self.EVERY)
        self._blocks += 1
        ue = np.repeat(np.arange(len(group)), group.counts)[every]
        follow = (group.starts + group.counts)[ue] - 1 - np.arange(len(csi))[every]
        frames = csi[group.order[every]].reshape(len(ue), -1)
        others = sums[ue].reshape(len(ue), -1)
        others -= np.power(decay, follow).astype(np.float32)[:, None] * frames
        z = np.einsum("ki,ki->k", others.conj(), frames)
        size = np.abs(z).astype(np.float64)
        noise = energy(others) * energy(frames) / frames.shape[1]
        sure = size**2 > self.SIGNIFICANCE * noise
        keep = np.exp(-int(sure.sum()) / self.MEMORY)
        self._cosines = keep * self._cosines + float((z.real[sure] / size[sure]).sum())
        self._count = keep * self._count + int(sure.sum())
