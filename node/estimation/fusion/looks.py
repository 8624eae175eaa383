"""What each array says of one UE: its power over bearing and range, from the newest transmission."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import ifft

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.certainty import Fused
from chachart.node.estimation.fusion.events import Events
from chachart.node.estimation.fusion.received import Received
from chachart.node.estimation.fusion.site import OVERSAMPLING, Complex, Floats, Site

KEPT_BYTES = 64 * 1024**2
BEARINGS = 181
_FAINTEST = 1e-30


class Looks:
    """Keeps the newest transmission of each UE, of so many UEs as fit, to look at it when somebody asks.

    Parameters
    ----------
    sites, arrays
        The arrays as fusion sees them, and as they are described.
    """

    def __init__(self, sites: Sequence[Site], arrays: Sequence[ArrayGeometry]) -> None:
        self._sites, self._arrays = tuple(sites), tuple(arrays)
        self._kept: OrderedDict[int, tuple[list[Complex], Floats, Floats]] = OrderedDict()
        self._most: int | None = None

    def see(self, events: Events, fused: Fused) -> None:
        """Transmissions, and where they came from."""
        for i, ue in enumerate(events.ue.tolist()):
            frames = [frame[i : i + 1].copy() for frame in events.frames]
            self._kept[ue] = frames, fused.position[i], fused.shares[i]
            self._kept.move_to_end(ue)
        if self._most is None and self._kept:
            frames, *_ = next(iter(self._kept.values()))
            self._most = max(1, KEPT_BYTES // sum(frame.nbytes for frame in frames))
        while self._most is not None and len(self._kept) > self._most:
            self._kept.popitem(last=False)

    def remove(self, ues: NDArray[np.uint64]) -> None:
        """They are forgotten."""
        for ue in ues.tolist():
            self._kept.pop(ue, None)

    def spectrum(self, ue: int) -> dict[str, Any] | None:
        """What `ChartEstimator.spectrum` has of the array that hears it best, and `arrays`: one map each.

        Each has `name`, `at` (x, y of the array), `bearing_grid_rad` (world azimuth) with `bearing_spectrum`,
        `bearing_rad` of its peak, `rho_grid_m` with `rho_spectrum` towards the fused position, `share` of its
        energy that this explains, and `power_db`. None where the UE is not kept.
        """
        kept = self._kept.get(ue)
        if kept is None:
            return None
        frames, position, shares = kept
        arrays = [
            self._look(i, frame, position, float(shares[i]))
            for i, frame in enumerate(frames)
            if frame.any() and np.isfinite(position).all()
        ]
        if not arrays:
            return None
        best = max(arrays, key=lambda one: one["power_db"])
        array = next(a for a in self._arrays if a.name == best["name"])
        theta, rho = array.theta_rho(position)
        points = _around(np.asarray(best["at"]), best["bearing_grid_rad"], position)
        cone = array.theta_rho(points)[0]
        order = np.argsort(cone)
        return {
            "theta": float(theta),
            "rho": float(rho),
            "theta_grid_rad": cone[order],
            "theta_spectrum": best["bearing_spectrum"][order],
            "rho_grid_m": best["rho_grid_m"],
            "rho_spectrum": best["rho_spectrum"],
            "arrays": [{key: _plain(value) for key, value in one.items()} for one in arrays],
        }

    def _look(self, number: int, frame: Complex, position: Floats, share: float) -> dict[str, Any]:
        site = self._sites[number]
        received = Received(site, frame)
        centre = site.centre
        grid = np.linspace(-np.pi, np.pi, 2 * BEARINGS - 1)[:-1]
        if site.normal is not None and np.hypot(*site.normal[:2]) > 0.5:
            facing = np.arctan2(site.normal[1], site.normal[0])
            grid = facing + np.linspace(-np.pi / 2, np.pi / 2, BEARINGS)[1:-1]
        power = received.best_power(_around(centre, grid, position)[None])[0].astype(np.float64)
        beamed = (site.match(position[None, None], site.ranges(position[None, None])[0]) @ frame)[0, 0]
        delays = OVERSAMPLING * len(beamed)
        z = ifft(beamed, delays, norm="forward")
        return {
            "name": site.name,
            "at": centre[:2].tolist(),
            "bearing_grid_rad": grid,
            "bearing_spectrum": np.maximum(power, _FAINTEST),
            "bearing_rad": float(np.angle(np.exp(1j * grid[power.argmax()]))),
            "rho_grid_m": np.arange(delays) * (site.unambiguous_m / delays),
            "rho_spectrum": np.maximum((z.real**2 + z.imag**2).astype(np.float64), _FAINTEST),
            "share": share,
            "power_db": float(10 * np.log10(max(float(power.max()), _FAINTEST))),
        }


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _around(centre: NDArray[Any], bearings: Floats, position: Floats) -> Floats:
    """Points (Q, 3) as far from an array, and as high, as `position`, in other directions."""
    away = max(float(np.hypot(*(position[:2] - centre[:2]))), 0.1)
    points = np.empty((len(bearings), 3))
    points[:, 0] = centre[0] + away * np.cos(bearings)
    points[:, 1] = centre[1] + away * np.sin(bearings)
    points[:, 2] = position[2]
    return points
