"""One coordinate by one spectral method: the state of every UE, and what it says about a block's UEs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation import order, spectra
from chachart.node.estimation.bounds import minnorm_excess, mvdr_excess, stochastic_std
from chachart.node.estimation.covariance import Bank, Grouping, covariances, forward_backward
from chachart.node.estimation.evidence import AxisEvidence
from chachart.node.estimation.judge import inflated
from chachart.node.estimation.lag_sums import LagSums
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.locator import Columns
from chachart.node.estimation.manifold import Search, UniformManifold, derivatives, phasors
from chachart.node.estimation.options import Options
from chachart.node.estimation.state import Slots, SlotState
from chachart.node.estimation.subspace import SubspaceTracker, dominant

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]


class SpectralAxis(SlotState):
    """A spectral method on a manifold. Bartlett keeps 2 L real numbers a UE, the others N x N complex ones.

    Parameters
    ----------
    name
        "theta" or "rho": the column that it estimates, and whose errors it has learnt about.
    method
        One of `options.SPECTRAL`.
    manifold, step
        Where to look, and how finely before refinement.
    snapshots
        M, snapshots a frame.
    """

    def __init__(
        self,
        name: str,
        method: str,
        manifold: UniformManifold,
        step: float | None,
        snapshots: int,
        options: Options,
    ) -> None:
        n = manifold.size
        self.name, self.method, self.options = name, method, options
        self.snapshots, self.whole = snapshots, manifold
        shape = (len(manifold.lattice.lags),) if method == "bartlett" else (n, n)
        self._bank = Bank(shape, np.complex64, options.decay)
        if options.smoothing < 1 and method != "bartlett" and manifold.lattice.dense:
            n = min(max(2, round(options.smoothing * n)), n)
            manifold = replace(manifold, lattice=Lattice.even(n))
        self.manifold = manifold
        self.search = Search(manifold, step, options.newton_steps)
        self._lags, self._whole_lags = LagSums(manifold.lattice), LagSums(self.whole.lattice)
        self._excess = np.sqrt(minnorm_excess(manifold.lattice)) if method == "minnorm" else 1.0
        cell = 2 * np.pi / manifold.lattice.span / abs(manifold.phase)
        self._evidence = AxisEvidence(manifold.lattice, cell)
        super().__init__(bank=self._bank)
        if method in ("music", "minnorm") and isinstance(options.signal_order, int):
            self._tracker = SubspaceTracker(n, options.signal_order)
            self.children["tracker"] = self._tracker

    def of_frames(self, x: Complex) -> Complex:
        """What is kept of each frame, from snapshot matrices x (K, N, M).

        Lag polynomials (K, L) for Bartlett, covariances (K, N, N) for the others.
        """
        if self.method == "bartlett":
            return self._lags.of_products(x)
        return covariances(x)

    def energy(self, kept: Complex) -> NDArray[Any]:
        """Sum of |h|^2 of each frame (K,)."""
        total: NDArray[Any] = kept[:, 0].real if kept.ndim == 2 else np.einsum("kii->k", kept).real
        return total

    def take(self, group: Grouping, features: Complex) -> Complex:
        """Take what is kept of a block's frames; returns the sums of its UEs."""
        sums: Complex = self._bank.add(group, features)
        return sums

    def estimate(self, group: Grouping, sums: Complex, weight: Floats, frames: Floats) -> Columns:
        """Estimate a block's UEs.

        Parameters
        ----------
        sums
            Of `take`.
        weight, frames
            (U,) sum of the weights of each UE's frames, and their effective number.
        """
        n, snapshots = self.manifold.size, frames * self.snapshots
        scale = weight * (self.snapshots * n)
        if self.method == "bartlett":
            u, _ = self.search.extremum(sums, maximum=True)
            return self._judge(u, sums / scale[:, None], snapshots)
        r = self._prepared(sums)
        factor = self._factor(r, group.slots, snapshots)
        c = self._lags.of_products(factor)
        u, value = self.search.extremum(c, maximum=self.method in spectra.MAXIMUM)
        u[np.isnan(value)] = np.nan
        return self._judge(u, self._lags.of(r) / scale[:, None], snapshots)

    def deviation(self, at: Columns, growth: Floats) -> Floats:
        """Deviation (U,) of the coordinate where echoes make the variance of noise grow: see `inflated`."""
        u, noise = at[f"{self.name}_u"], at[f"{self.name}_u_std"]
        most = np.maximum((self.manifold.high - self.manifold.low) / np.sqrt(12), noise)
        return self.manifold.coordinate_std(u, np.minimum(inflated(noise, growth), most))

    def mean_lags(self, slots: Slots, weight: Floats) -> Complex:
        """Lag polynomials (U, L) of the average covariances, per element: the first is the mean power."""
        sums = self._bank.rows[slots]
        lags = sums if self.method == "bartlett" else self._whole_lags.of(sums)
        scale = weight * (self.snapshots * self.whole.size)
        return np.asarray(lags / scale[:, None], np.complex128)

    def spectrum(self, slot: int, frames: float, points: int) -> tuple[Floats, Floats]:
        """Coordinate grid and spectrum (largest value 1) of one UE, in double precision."""
        c: Complex = self._bank.rows[[slot]].astype(np.complex128)
        if self.method != "bartlett":
            r = self._prepared(c)
            factor = self._factor(r, None, np.array([frames * self.snapshots]))
            c = self._lags.of_products(factor)
        grid = self.manifold.points(points)
        power = derivatives(np.repeat(c.T, points, axis=1), self.manifold.u(grid), self.manifold.lattice)[0]
        if self.method == "music":
            power = self.manifold.size - power
        if self.method != "bartlett":
            power = 1 / np.maximum(power, 1e-12 * power.max())
        return grid, power / power.max()

    def _prepared(self, r: Complex) -> Complex:
        """Covariances (U, N, N) after sub-array smoothing and forward-backward averaging."""
        n, shifts = self.manifold.size, self.whole.size - self.manifold.size + 1
        if shifts > 1:
            r = np.mean([r[:, i : i + n, i : i + n] for i in range(shifts)], axis=0)
        return forward_backward(r) if self.options.forward_backward else r

    def _factor(self, r: Complex, slots: Slots | None, snapshots: Floats) -> Complex:
        """The method's factor X of covariances r (U, N, N); without `slots` no subspace is tracked."""
        if self.method == "mvdr":
            return spectra.mvdr(r, self.options.loading)
        wanted = self.options.signal_order
        if isinstance(wanted, int):
            basis = dominant(r, wanted) if slots is None else self._tracker.update(slots, r, snapshots)
            signal = basis.conj().swapaxes(1, 2)
        else:
            values, vectors = spectra.eigh(r)
            if wanted == "mdl":
                orders = order.mdl(values, snapshots)
            else:
                orders = order.threshold(values, self.options.order_threshold)
            signal = order.leading(vectors, orders)
        return signal if self.method == "music" else spectra.minnorm(signal)

    def _judge(self, u: Floats, lags: Complex, snapshots: Floats) -> Columns:
        """Power of the path at u, of the rest, and the deviation that noise alone gives it; the evidence.

        For a path in white noise `total` = tr R / N is P + sigma^2, `beam` = aᴴRa / N^2 is P + sigma^2 / N.
        """
        n, total = self.manifold.size, lags[:, 0].real.astype(np.float64)
        turned = lags * phasors(u, self.manifold.lattice.lags).T
        beam = turned.real.sum(axis=1) / n
        power = np.maximum((n * beam - total) / (n - 1), total / np.sqrt(n * snapshots))
        noise = np.maximum(total - power, 1e-6 * total)
        u_std = stochastic_std(self.manifold.lattice, snapshots, power / noise)
        if self.method == "minnorm":
            u_std *= self._excess
        elif self.method == "mvdr":
            mirrored = 2 if self.options.forward_backward else 1
            u_std *= np.sqrt(mvdr_excess(n, mirrored * snapshots, power / noise, self.options.loading))
        return {
            self.name: self.manifold.coordinate(u),
            f"{self.name}_noise_std": self.manifold.coordinate_std(u, u_std),
            f"{self.name}_u": u,
            f"{self.name}_u_std": u_std,
            f"{self.name}_evidence": self._evidence.of(lags, turned, u_std, snapshots),
            "power": power,
            "noise": noise,
        }
