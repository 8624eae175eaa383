"""One coordinate by one spectral method: the state of every UE, and what it says about a block's UEs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation import order, spectra
from chachart.node.estimation.bounds import stochastic_std
from chachart.node.estimation.covariance import Bank, Grouping, LagSums, covariances, forward_backward
from chachart.node.estimation.manifold import Search, UniformManifold, derivatives
from chachart.node.estimation.options import Options
from chachart.node.estimation.slots import Slots

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

MATRIX_LIMIT = 512
"""Methods that need the covariance itself keep N x N numbers a UE; beyond this size they are refused."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisEstimate:
    """What one axis says about U UEs.

    Attributes
    ----------
    value, std
        The coordinate and its standard deviation, (U,).
    power, noise
        (U,) per element: power of the path found, and of everything else.
    """

    value: Floats
    std: Floats
    power: Floats
    noise: Floats


class SpectralAxis:
    """A spectral method on a manifold. Bartlett keeps 2 N real numbers a UE, the others N x N complex ones.

    Parameters
    ----------
    name
        "theta" or "rho", for error messages.
    method
        One of `options.SPECTRAL`.
    manifold, step
        Where to look, and how finely before refinement.
    snapshots
        M, snapshots a frame.

    Raises
    ------
    ValueError
        If the manifold is too small, or too large for the method's state.
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
        if n < 2:
            raise ValueError(f"{name} = {method!r} needs at least 2 elements along its axis, not {n}")
        if method != "bartlett" and n > MATRIX_LIMIT:
            raise ValueError(
                f"{name} = {method!r} keeps {n} x {n} numbers a UE; above {MATRIX_LIMIT} only bartlett"
            )
        if (
            isinstance(options.signal_order, int)
            and method in ("music", "minnorm")
            and options.signal_order >= n
        ):
            raise ValueError(f"signal_order must be below {n}, the elements of the {name} axis")
        self.method, self.manifold, self.snapshots, self.options = method, manifold, snapshots, options
        self.search = Search(manifold, step, options.newton_steps)
        shape = (n,) if method == "bartlett" else (n, n)
        self._bank = Bank(shape, np.complex64, options.decay)
        self._lags = LagSums(n)

    def resize(self, capacity: int) -> None:
        """Have state for `capacity` slots."""
        self._bank.resize(capacity)

    def clear(self, slots: Slots) -> None:
        """Start `slots` afresh."""
        self._bank.clear(slots)

    def update(self, group: Grouping, x: Complex, weight: Floats, frames: Floats) -> AxisEstimate:
        """Take a block and estimate its UEs.

        Parameters
        ----------
        x
            Snapshot matrices (K, N, M).
        weight, frames
            (U,) sum of the weights of each UE's frames, and their effective number.
        """
        per_frame = self._lags.of_snapshots(x) if self.method == "bartlett" else covariances(x)
        sums = self._bank.add(group, per_frame)
        power_lags, c = self._polynomials(sums, frames)
        u = self.search.extremum(c, maximum=self.method in spectra.MAXIMUM)
        return self._judge(u, power_lags, weight, frames)

    def spectrum(self, slot: int, frames: float, points: int) -> tuple[Floats, Floats]:
        """Coordinate grid and spectrum (largest value 1) of one UE."""
        sums = self._bank.rows[[slot]].astype(np.complex128)
        _, c = self._polynomials(sums, np.array([frames]))
        ends = self.manifold.coordinate(np.array([self.manifold.low, self.manifold.high]))
        grid = np.linspace(ends.min(), ends.max(), points)
        power = derivatives(np.repeat(c, points, axis=0), self.manifold.u(grid))[0]
        if self.method == "music":
            power = self.manifold.size - power
        if self.method != "bartlett":
            power = 1 / np.maximum(power, 1e-12 * power.max())
        return grid, power / power.max()

    def _polynomials(self, sums: Complex, frames: Floats) -> tuple[Complex, Complex]:
        """Lag polynomials of the received power and of the method's spectrum, both (U, N)."""
        if self.method == "bartlett":
            return sums, sums
        r = forward_backward(sums) if self.options.forward_backward else sums
        if self.method == "mvdr":
            factor = spectra.mvdr(r, self.options.loading)
        else:
            signal = self._signal(r, frames)
            factor = signal if self.method == "music" else spectra.minnorm(signal)
        return self._lags.of(r), self._lags.of_snapshots(factor)

    def _signal(self, r: Complex, frames: Floats) -> Complex:
        values, vectors = np.linalg.eigh(r)
        wanted = self.options.signal_order
        if wanted == "threshold":
            orders = order.threshold(values, self.options.order_threshold)
        elif wanted == "mdl":
            orders = order.mdl(values, frames * self.snapshots)
        else:
            orders = np.full(len(r), wanted, np.intp)
        return order.eigenvectors(r, orders, (values, vectors))

    def _judge(self, u: Floats, power_lags: Complex, weight: Floats, frames: Floats) -> AxisEstimate:
        """Power of the path at u, of the rest, and the standard deviation that follows from them.

        aᴴRa / N^2 = P + sigma^2 / N and tr R / N = P + sigma^2 for one path in white noise.
        """
        n = self.manifold.size
        lags = power_lags.astype(np.complex128)
        lags /= (weight * self.snapshots)[:, None]
        total = lags[:, 0].real / n
        beam = derivatives(lags, u)[0] / n**2
        m = frames * self.snapshots
        least = total / np.sqrt(n * m)
        power = np.maximum((n * beam - total) / (n - 1), least)
        noise = np.maximum(total - power, 1e-6 * total)
        u_std = stochastic_std(n, m, power / noise)
        if self.method == "minnorm":
            u_std *= np.sqrt((n + 1) / 6)
        manifold = self.manifold
        return AxisEstimate(manifold.coordinate(u), manifold.coordinate_std(u, u_std), power, noise)
