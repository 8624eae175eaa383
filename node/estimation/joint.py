"""theta and rho together: the direct path in the angle-delay spectrum of each UE's frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.covariance import Grouping, Weights
from chachart.node.estimation.direct_path import DirectPath
from chachart.node.estimation.directions.direct_path import DirectionPath
from chachart.node.estimation.locator import Columns, Features, Locator
from chachart.node.estimation.options import Options
from chachart.node.estimation.periodogram import CoherentSums, Csi, PowerSums, SpectrumState, energy
from chachart.node.estimation.phase_watch import PhaseWatch
from chachart.node.estimation.state import Slots, SlotState

Floats = NDArray[np.float64]


class JointLocator(Locator):
    """The joint angle-delay method: `DirectPath` on averaged spectra.

    Averages a UE's frames themselves while they keep their phase, which finds weak paths best, and their
    power spectra while they do not (see `PhaseWatch`). A change takes over what has been averaged so far.

    Parameters
    ----------
    array, options
        As of `ChartEstimator`.
    """

    BY_SLOT = ("_random",)

    def __init__(self, array: ArrayGeometry, options: Options) -> None:
        self._array, self._options = array, options
        self._direct_path = DirectPath(array, options.rho_max_m, options.echoes)
        periodogram = self._direct_path.periodogram
        self._weights = Weights(options.decay)
        self._sums = CoherentSums(periodogram, options.decay)
        self._powers = PowerSums(periodogram, options.decay)
        self._watch = PhaseWatch(options.decay)
        self._phase = options.phase
        self._random = np.zeros(0, np.bool_)
        super().__init__(weights=self._weights)
        used: dict[str, dict[str, SlotState]] = {
            "steady": {"sums": self._sums},
            "random": {"powers": self._powers},
            "auto": {"sums": self._sums, "powers": self._powers, "watch": self._watch},
        }
        self.children |= used[options.phase]

    def features(self, csi: Csi) -> Features:
        """The frames (K, N_R, N_S)."""
        return Features(energy(csi.reshape(len(csi), -1)), {"csi": csi})

    def estimate(self, group: Grouping, features: Features, position: NDArray[np.float32]) -> Columns:
        """Take a block's frames and locate its UEs; `position` is of no use here."""
        csi = features.kept["csi"]
        _, frames = self._weights.add(group)
        random = self._add(group, csi)
        if not random.any():
            at = self._locate(self._sums, group.slots)
        elif random.all():
            at = self._locate(self._powers, group.slots)
        else:
            parts = [(self._sums, np.flatnonzero(~random)), (self._powers, np.flatnonzero(random))]
            places = np.argsort(np.concatenate([which for _, which in parts]))
            pieces = [self._locate(state, group.slots[which]) for state, which in parts]
            at = {name: np.concatenate([piece[name] for piece in pieces])[places] for name in pieces[0]}
        return at | {"snapshots": frames}

    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """theta_grid_rad, theta_spectrum, rho_grid_m, rho_spectrum: the maxima along the other axis.

        Where frames keep their phase there are the strongest paths, too, see `DirectionPath.apart`.
        """
        slots = np.array([slot])
        if self._weights.of(slots)[1][0] == 0:
            return None
        angle, delay = self._direct_path.angle, self._direct_path.delay
        theta, rho = angle.points(points), delay.points(points)
        state = self._powers if self._phase == "random" or self._random[slot] else self._sums
        power = self._direct_path.periodogram.sampled(
            state.spectra(slots)[0][0], angle.u(theta), -delay.u(rho)
        )
        power /= power.max()
        found = self._apart(slots) if state is self._sums else {}
        return found | {
            "theta_grid_rad": theta,
            "theta_spectrum": power.max(axis=1),
            "rho_grid_m": rho,
            "rho_spectrum": power.max(axis=0),
        }

    def _apart(self, slots: Slots) -> dict[str, Any]:
        """The strongest paths of one UE."""
        model = DirectionPath(self._array, self._options.rho_max_m, paths=self._options.paths)
        return model.apart(self._sums.bank.rows[slots], np.ones(1))

    def _add(self, group: Grouping, csi: Csi) -> NDArray[np.bool_]:
        """Take a block's frames; which UEs (U,) are to be located by their power spectra."""
        slots = group.slots
        if self._phase == "random":
            self._powers.take(group, csi)
            return np.ones(len(slots), np.bool_)
        if self._phase == "steady":
            self._sums.take(group, csi)
            return np.zeros(len(slots), np.bool_)
        was = self._random[slots]
        if was.any():
            self._sums.fade(slots[was], self._watch.fading(group.counts[was]))
        self._sums.take(group, csi)
        self._watch.look(group, csi, self._sums.bank.rows, was)
        now = self._watch.random(slots, was)
        if now.any() or was.any():
            self._change(group, csi, was, now)
        return now

    def _change(self, group: Grouping, csi: Csi, was: NDArray[np.bool_], now: NDArray[np.bool_]) -> None:
        """Bring the power spectra up to date for UEs (U,) whose phases were and are now random."""
        if (stay := was & now).any():
            part, frames = group.part(stay)
            self._powers.take(part, csi[frames])
        if (fresh := now & ~was).any():
            self._powers.take_over(group.slots[fresh], self._sums)
        if (steady := was & ~now).any():
            self._powers.clear(group.slots[steady])
            self._weights.copy_from(self._sums.weights, group.slots[steady])
        self._random[group.slots] = now

    def _locate(self, state: SpectrumState, slots: Slots) -> Columns:
        """Where the UEs are, and their SNR; echoes count as noise, as they do on one axis."""
        chunk = self._direct_path.periodogram.chunk
        pieces = []
        for i in range(0, len(slots), chunk):
            power, looks, gain = state.spectra(slots[i : i + chunk])
            at = self._direct_path.find(power, looks)
            at["snr"] = 10 * np.log10(at["power"] / (at["noise"] + (gain - 1) * at["floor"]))
            pieces.append(at)
        return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
