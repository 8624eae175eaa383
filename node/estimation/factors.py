"""From covariances to the factors X of a spectral method, whatever the array; see `spectra`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation import order, spectra
from chachart.node.estimation.options import Options
from chachart.node.estimation.state import Slots, SlotState
from chachart.node.estimation.subspace import SubspaceTracker, dominant

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]


class Factors(SlotState):
    """MVDR's, MUSIC's or Min-Norm's X; the subspaces of the latter are tracked by slot.

    Parameters
    ----------
    method, options
        Which, and how.
    size
        N.
    ends
        Elements that Min-Norm fixes.
    """

    def __init__(self, method: str, size: int, options: Options, ends: NDArray[np.intp]) -> None:
        self.method, self._options, self._ends = method, options, ends
        super().__init__()
        if method in ("music", "minnorm") and isinstance(options.signal_order, int):
            self._tracker = SubspaceTracker(size, options.signal_order)
            self.children["tracker"] = self._tracker

    def of(self, r: Complex, slots: Slots | None, snapshots: Floats) -> Complex:
        """X (U, N, ...) of covariances r (U, N, N); without `slots` no subspace is tracked."""
        if self.method == "mvdr":
            return spectra.mvdr(r, self._options.loading)
        wanted = self._options.signal_order
        if isinstance(wanted, int):
            basis = dominant(r, wanted) if slots is None else self._tracker.update(slots, r, snapshots)
            signal = basis.conj().swapaxes(1, 2)
        else:
            values, vectors = spectra.eigh(r)
            if wanted == "mdl":
                orders = order.mdl(values, snapshots)
            else:
                orders = order.threshold(values, self._options.order_threshold)
            signal = order.leading(vectors, orders)
        return signal if self.method == "music" else spectra.minnorm(signal, self._ends)
