"""Poses of arrays and offsets of their clocks, from the paths by which they have heard UEs at known places.

After a first guess (`first_pose`), all arrays are fitted together by least squares with Tukey's weights,
whose scale is what the residuals of the direct paths show; UEs' own clocks are projected out. Deviations are
those of an M-estimator whose errors belong together by place ("sandwich"), but never below what noise leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from chachart.node.data.placement import Placement
from chachart.node.data.pose import Vector
from chachart.node.estimation.fusion.first_pose import ENOUGH, guess
from chachart.node.estimation.fusion.fuser import Clock
from chachart.node.estimation.fusion.heard import OFFSET, PARAMETERS, Heard, mode
from chachart.node.estimation.fusion.site import Floats

ROUNDS = 30
TUKEY = 4.685
"""Residuals of so many deviations have no weight."""
LEAST_PLACES = 4
"""Places that a pose takes."""
LEAST_FIT = 0.4
"""Less of an array's frames on one pose is none."""
LOOSE_M, LOOSE_RAD = 1.0, 0.2
"""A pose that is known no better than this is not known."""
ON_A_LINE = 0.02
SIDE = 5
"""Echoes err alike at places near each other: within squares of an area of so many by so many."""


@dataclass(frozen=True)
class Placed:
    """What was found of one array.

    Attributes
    ----------
    placement
        Offset and pose, with deviations.
    fits
        Part of its frames whose strongest path is direct.
    frames, places
        How many it heard, and from how many places.
    moved_m, turned_rad
        From the description.
    """

    placement: Placement
    fits: float
    frames: int
    places: int
    moved_m: float
    turned_rad: float


def place(heard: Sequence[Heard], clock: Clock, clocks_only: bool = False) -> list[Placed]:
    """Poses and offsets of all arrays.

    Parameters
    ----------
    heard
        What each has heard.
    clock
        `shared`: UEs share the clock, offsets are absolute; `offset`: they do not, offsets are against the
        first array's; `own`: there is none.
    clocks_only
        Poses are as described.

    Raises
    ------
    ValueError
        If UEs do not determine what is looked for; the message says of which array, why, and what would.
    """
    fit = _Fit(heard, clock, clocks_only)
    fit.polish()
    deviations = fit.deviations()
    return [fit.told(b, deviations[b]) for b in range(len(heard))]


class _Fit:
    """The poses of all arrays while they are looked for."""

    def __init__(self, heard: Sequence[Heard], clock: Clock, clocks_only: bool) -> None:
        self._heard, self._clock = heard, clock
        every = np.concatenate([one.position for one in heard])
        where = np.unique(np.round(every, 2), axis=0, return_inverse=True)[1].reshape(-1)
        self._where = np.split(where, np.cumsum([len(one.event) for one in heard])[:-1])
        self._scale = np.ones((len(heard), 2))
        self._weight = [np.ones(len(one.event)) for one in heard]
        self._free: list[list[int]] = []
        for b, one in enumerate(heard):
            free = [] if clocks_only else [0, 1, 2, *((4, 5) if one.angles == 1 else (3, 4, 5))]
            if clock == "shared" or (clock == "offset" and b):
                free.append(OFFSET)
            self._free.append(free)
            self._check(b)
        shared = clock == "shared"
        self._pose = [guess(one, free, shared) for one, free in zip(heard, self._free, strict=True)]
        if clock == "offset":
            self._start_offsets()

    def _check(self, b: int) -> None:
        """Whether there are places enough, and not on one line."""
        name = self._heard[b].array.name
        places = len(np.unique(self._where[b]))
        needed = LEAST_PLACES if 0 in self._free[b] else 1
        if places < needed:
            raise ValueError(
                f"array {name} has heard UEs at {places} known places; a pose takes {needed} or more "
                "(its clock alone, with --clocks-only, takes one)"
            )
        if needed == 1:
            return
        there = self._heard[b].position
        size = np.linalg.svd(there - there.mean(axis=0), compute_uv=False)
        if size[1] < ON_A_LINE * size[0]:
            raise ValueError(
                f"array {name} has heard UEs on one straight line only, which leaves its pose open; "
                "add places beside that line, or use --clocks-only"
            )

    def _start_offsets(self) -> None:
        """Offsets against the first array, where UEs have clocks of their own."""
        late = [one.late(pose) for one, pose in zip(self._heard, self._pose, strict=True)]
        first = dict(zip(self._heard[0].event.tolist(), late[0].tolist(), strict=True))
        for b in range(1, len(self._heard)):
            one = self._heard[b]
            both = [k for k, event in enumerate(one.event.tolist()) if event in first]
            if not both:
                raise ValueError(
                    f"arrays {one.array.name} and {self._heard[0].array.name} have heard no transmission "
                    "in common, which their clocks could be compared by"
                )
            both = both[:: -(-len(both) // ENOUGH)]
            apart = late[b][both] - np.array([first[int(one.event[k])] for k in both])
            self._pose[b] = self._pose[b].late(mode(apart, one.unambiguous_m, one.cell_m))

    def polish(self) -> None:
        """Weighted least squares of everything at once, weights and scales taken anew in each round."""
        for number in range(ROUNDS):
            residual, jacobian, _ = self._system()
            self._reweigh(residual, annealed=max(1.0, 4.0 * 0.7**number))
            residual, jacobian, _ = self._system()
            step = np.asarray(np.linalg.lstsq(jacobian, -residual, rcond=1e-9)[0], np.float64)
            self._move(step)
            if number > 12 and np.abs(step).max(initial=0.0) < 1e-7:
                break

    def told(self, b: int, std: Floats) -> Placed:
        """What was found of an array, with deviations (7,).

        Raises
        ------
        ValueError
            If too little fits one pose, or leaves it open.
        """
        one, pose = self._heard[b], self._pose[b]
        name, light = one.array.name, one.array.light_speed_m_s
        fits = float((self._weight[b] > 0.05).mean())
        if fits < LEAST_FIT:
            raise ValueError(
                f"array {name}: only {100 * fits:.0f} % of its frames fit one pose; does it see the UEs, "
                "and are their places right?"
            )
        if std[:3].max() > LOOSE_M or std[3:OFFSET].max() > LOOSE_RAD:
            raise ValueError(
                f"array {name}: these places leave its pose open by {std[:3].max():.1f} m and "
                f"{np.degrees(std[3:OFFSET].max()):.0f} degrees; add places in other directions and "
                "distances, or use --clocks-only"
            )
        placement = Placement(name)
        if self._clock != "own":
            offset_s, std_s = pose.offset_m / light + 0.0, float(std[OFFSET] / light)
            placement = replace(placement, offset_s=offset_s, offset_std_s=std_s)
        moved, turned = 0.0, 0.0
        if 0 in self._free[b]:
            own = (one.array.centre_m - np.asarray(one.array.position_m)) @ one.array.frame.T
            placement = replace(
                placement,
                position_m=_vector(pose.middle - own @ pose.frame),
                axis=_vector(pose.frame[0]),
                broadside=_vector(pose.frame[2]),
                position_std_m=_vector(std[:3]),
                turn_std_rad=_vector(std[3:OFFSET]),
            )
            moved = float(np.linalg.norm(pose.middle - one.array.centre_m))
            turned = float(Rotation.from_matrix(pose.frame @ one.array.frame.T).magnitude())
        return Placed(placement, fits, len(one.event), len(np.unique(self._where[b])), moved, turned)

    def _whitened(self, b: int) -> tuple[Floats, Floats]:
        """Residuals (K, A + 1) in their deviations, and slopes (K, A + 1, 7)."""
        one = self._heard[b]
        off, slopes = one.off(self._pose[b]), one.slopes(self._pose[b])
        white = np.zeros((len(off), one.angles + 1, one.angles + 1))
        white[:, :-1, :-1] = np.linalg.inv(np.linalg.cholesky(one.paths.angle_cov))
        white[:, -1, -1] = 1 / np.sqrt(one.paths.length_var)
        white /= np.append(np.full(one.angles, self._scale[b, 0]), self._scale[b, 1])[:, None]
        if self._clock == "own":
            white[:, -1] = 0
        return np.einsum("kij,kj->ki", white, off), np.einsum("kij,kjp->kip", white, slopes)

    def _system(self) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Weighted residuals (M,) and slopes (M, P) of all arrays, and the place (M,) that each is of."""
        width = sum(map(len, self._free))
        residuals, jacobians, events, delays, places = [], [], [], [], []
        start = 0
        for b, one in enumerate(self._heard):
            r, j = self._whitened(b)
            root = np.sqrt(self._weight[b])[:, None]
            r, j = r * root, j * root[..., None]
            whole = np.zeros((*r.shape, width))
            whole[..., start : start + len(self._free[b])] = j[..., self._free[b]]
            start += len(self._free[b])
            late = np.zeros(r.shape)
            late[:, -1] = root[:, 0] / (np.sqrt(one.paths.length_var) * self._scale[b, 1])
            residuals.append(r.reshape(-1))
            jacobians.append(whole.reshape(-1, width))
            delays.append(late.reshape(-1))
            events.append(np.repeat(one.event, r.shape[1]))
            places.append(np.repeat(self._where[b], r.shape[1]))
        residual, jacobian = np.concatenate(residuals), np.concatenate(jacobians)
        event, delay = np.concatenate(events), np.concatenate(delays)
        if self._clock == "offset":
            residual, jacobian = _without_own_clocks(residual, jacobian, event, delay)
        return residual, jacobian, np.concatenate(places)

    def _reweigh(self, residual: Floats, annealed: float) -> None:
        """Tukey's weights by the residuals of each frame in deviations that they show themselves."""
        start = 0
        for b, one in enumerate(self._heard):
            width = one.angles + 1
            count = len(one.event)
            r = residual[start : start + count * width].reshape(count, width)
            start += count * width
            r = r / np.sqrt(np.maximum(self._weight[b], 1e-12))[:, None]
            r = r * np.append(np.full(one.angles, self._scale[b, 0]), self._scale[b, 1])
            seen = self._weight[b] > 1e-6
            seen = seen if seen.mean() > 0.5 else np.ones(count, np.bool_)
            for kind, part in enumerate((r[:, :-1], r[:, -1:])):
                mad = 1.4826 * float(np.median(np.abs(part[seen])))
                self._scale[b, kind] = max(1.0, mad)
            d = r / np.append(np.full(one.angles, self._scale[b, 0]), self._scale[b, 1])
            size = np.sqrt(np.max(d * d, axis=1)) / (TUKEY * annealed)
            self._weight[b] = np.where(size < 1, (1 - size**2) ** 2, 0.0) + 1e-12

    def _move(self, step: Floats) -> None:
        start = 0
        for b, free in enumerate(self._free):
            move = np.zeros(PARAMETERS)
            move[free] = np.clip(step[start : start + len(free)], -0.5, 0.5)
            start += len(free)
            self._pose[b] = self._pose[b].moved(move)

    def _cells(self) -> NDArray[np.intp]:
        """In which part of the area each place is: rows and columns of as many places each."""
        every, where = np.concatenate([one.position for one in self._heard]), np.concatenate(self._where)
        there = every[np.unique(where, return_index=True)[1]]
        count = len(there)
        if count <= SIDE * SIDE:
            return np.arange(count)
        row = np.argsort(np.argsort(there[:, 0], kind="stable")) * SIDE // count
        rank = np.empty(count, np.intp)
        rank[np.lexsort((there[:, 1], row))] = np.arange(count)
        return rank * SIDE * SIDE // count

    def deviations(self) -> Floats:
        """Of all parameters, (B, 7); 0 of those that are as described."""
        residual, jacobian, place = self._system()
        cell = self._cells()[place]
        normal = jacobian.T @ jacobian
        variance = np.diag(_inverse(normal))
        cells = int(cell.max()) + 1
        moves = np.zeros((cells, len(normal)))
        for g in range(cells):
            part = jacobian[cell == g]
            moves[g] = _inverse(normal - part.T @ part) @ (part.T @ residual[cell == g])
        variance = np.maximum(variance, (cells - 1) / cells * np.sum(moves**2, axis=0))
        found, start = np.zeros((len(self._heard), PARAMETERS)), 0
        for b, free in enumerate(self._free):
            found[b, free] = np.sqrt(variance[start : start + len(free)])
            start += len(free)
        return found


def _inverse(normal: Floats) -> Floats:
    return np.asarray(np.linalg.pinv(normal, rcond=1e-14, hermitian=True), np.float64)


def _without_own_clocks(
    residual: Floats, jacobian: Floats, event: NDArray[np.intp], delay: Floats
) -> tuple[Floats, Floats]:
    """Residuals and slopes without what a common delay of each transmission explains."""
    size = int(event.max()) + 1
    norm = np.maximum(np.bincount(event, delay * delay, size), 1e-30)
    explained = np.bincount(event, delay * residual, size) / norm
    columns = np.zeros((size, jacobian.shape[1]))
    np.add.at(columns, event, jacobian * delay[:, None])
    columns /= norm[:, None]
    return residual - delay * explained[event], jacobian - delay[:, None] * columns[event]


def _vector(values: Floats) -> Vector:
    x, y, z = (float(v) + 0.0 for v in values)
    return (x, y, z)
