"""Direction and range together, for arrays that are no uniform line: what `JointLocator` is for lines."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.covariance import Bank, Grouping, Weights
from chachart.node.estimation.directions.axis import picture, profiles
from chachart.node.estimation.directions.direct_path import DirectionPath
from chachart.node.estimation.directions.spectrum import Csi
from chachart.node.estimation.locator import Columns, Features, Locator
from chachart.node.estimation.options import Options
from chachart.node.estimation.periodogram import energy
from chachart.node.estimation.state import Slots

UES_AT_ONCE = 256


class DirectionLocator(Locator):
    """The joint angle-delay method, on the sum of each UE's frames.

    Unless `phase` is "steady", every frame is turned to the phase of the sum that it joins: so oscillators
    that start anew with every frame cost nothing, and echoes that move against one another no more than a
    part of themselves.

    Parameters
    ----------
    array, options
        As of `ChartEstimator`.
    """

    def __init__(self, array: ArrayGeometry, options: Options) -> None:
        self.direct_path = DirectionPath(
            array, options.rho_max_m, elevation=options.elevation, paths=options.paths
        )
        self._aligned = options.phase != "steady"
        self._decay = options.decay
        self._weights = Weights(options.decay)
        live = int(array.live_antennas.sum()), int(array.live_tones.sum())
        self._bank = Bank(live, np.complex64, options.decay)
        super().__init__(weights=self._weights, sums=self._bank)

    def features(self, csi: Csi) -> Features:
        """The frames."""
        return Features(energy(csi.reshape(len(csi), -1)), {"frames": csi})

    def estimate(self, group: Grouping, features: Features, position: NDArray[np.float32]) -> Columns:
        """Take a block's frames and locate its UEs; `position` is of no use here."""
        csi = features.kept["frames"]
        if self._aligned:
            csi = self._turned(group, csi)
        _, frames = self._weights.add(group)
        self._bank.add(group, csi)
        pieces = []
        for start in range(0, len(group), UES_AT_ONCE):
            sums, gain = self.frames(group.slots[start : start + UES_AT_ONCE])
            pieces.append(self.direct_path.find(sums, gain))
        at = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
        return at | {"snapshots": frames}

    def frames(self, slots: Slots) -> tuple[Csi, NDArray[np.float64]]:
        """Sums (U, N_R, N_S) of the slots' frames at the noise of one frame, and of how many, (U,)."""
        weight, frames = self._weights.of(slots)
        sums = self._bank.rows[slots]
        sums *= (np.sqrt(frames) / weight).astype(np.float32)[:, None, None]
        return sums, frames

    def spectrum(self, slot: int, points: int) -> dict[str, Any] | None:
        """Grids and spectra of theta, azimuth, elevation and rho: the maxima along the others; and paths."""
        slots = np.array([slot])
        if self._weights.of(slots)[1][0] == 0:
            return None
        model = self.direct_path.spectrum
        h = self.frames(slots)[0][0]
        rho = model.delay.points(points)
        v = -model.delay.u(rho)
        y = h.astype(np.complex128) @ np.exp(1j * model.tones.index[:, None] * v)
        d, shape = picture(model.manifold)
        by_rho, by_direction = np.zeros(len(rho)), np.zeros(len(d))
        for start in range(0, len(d), 2048):
            part = slice(start, start + 2048)
            power = np.abs(model.manifold.steering(d[part]).conj() @ y) ** 2
            by_direction[part] = power.max(axis=1)
            by_rho = np.maximum(by_rho, power.max(axis=0))
        found: dict[str, Any] = profiles(d, by_direction / by_direction.max(), shape, points)
        found |= {"rho_grid_m": rho, "rho_spectrum": by_rho / by_rho.max()}
        return found | self.direct_path.apart(*self.frames(slots))

    def _turned(self, group: Grouping, csi: Csi) -> Csi:
        """The frames, each at the phase of the sum of all earlier ones of its UE; the first as it is."""
        fresh = self._weights.of(group.slots)[0][group.busiest] == 0
        if group.single and fresh.all():
            return csi
        sums = self._bank.rows[group.slots[group.busiest]]
        turned = csi.copy()
        frames, counts = group.rounds
        ends = np.cumsum(counts)
        for number, end in enumerate(ends):
            which = frames[end - counts[number] : end]
            now = slice(0, counts[number])
            if number or not fresh.any():
                turned[which] = alike(sums[now], csi[which])
            elif not fresh.all():
                known = which[~fresh]
                turned[known] = alike(sums[~fresh], csi[known])
            if end < len(csi):
                sums[now] *= np.float32(self._decay)
                sums[now] += turned[which]
        return turned


def alike(wanted: Csi, frames: Csi) -> Csi:
    """Frames (K, N_R, N_S), each turned to the phase of the one that is wanted."""
    one, other = wanted.reshape(len(frames), -1), frames.reshape(len(frames), -1)
    z = inner(one, other) + 1j * inner(one * np.complex64(1j), other)
    turn = np.where(np.abs(z) > 0, z.conj() / np.maximum(np.abs(z), 1e-30), 1)
    turned: Csi = frames * turn.astype(np.complex64)[:, None, None]
    return turned


def inner(a: Csi, b: Csi) -> NDArray[np.float32]:
    """Real part (K,) of the inner products of rows (K, N)."""
    product: NDArray[np.float32] = np.einsum("ki,ki->k", a.view(np.float32), b.view(np.float32))
    return product
