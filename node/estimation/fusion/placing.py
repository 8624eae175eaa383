"""Poses of arrays and offsets of their clocks, from the paths by which they have heard UEs at known places.

Each array's pose is first found from few frames at a time (RANSAC; Fischler and Bolles, Comm. ACM 24(6), 1981),
since any frame's strongest path may be an echo. Then all arrays are fitted together by least squares with
Tukey's weights, whose scale is what the residuals of the direct paths show; UEs' own clocks are projected out.
Deviations are those of an M-estimator whose errors belong together by place ("sandwich"), but never below what
noise alone leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.placement import Placement
from chachart.node.data.pose import Vector
from chachart.node.estimation.fusion.fuser import Clock
from chachart.node.estimation.fusion.site import Floats
from chachart.node.estimation.fusion.strongest import Paths

POSE, OFFSET = 6, 6
"""Parameters of an array: its middle (x, y, z), small turns about own axes, then its offset in metres."""
ROUNDS = 30
TRIES = 60
"""Random sets of frames ..."""
AT_A_TIME = 4
"""... of so many, and steps that each is fitted by."""
TRY_STEPS = 8
TUKEY = 4.685
"""Residuals of so many deviations have no weight."""
DOUBTFUL_RAD, DOUBTFUL_CELLS = 0.1, 0.15
"""Deviations that sets of frames are judged by."""
LEAST_PLACES = 4
"""Places that a pose takes."""
LEAST_FIT = 0.4
"""Less of an array's frames on one pose is none."""
LOOSE_M, LOOSE_RAD = 1.0, 0.2
"""A pose that is known no better than this is not known."""
ON_A_LINE = 0.02
_STEP = 1e-5


@dataclass(frozen=True)
class Heard:
    """What one array has heard of UEs at known places.

    Attributes
    ----------
    array
        As it is described.
    paths
        Strongest paths of K frames.
    event
        Of which transmission (K,) each is.
    cell_m, unambiguous_m
        Resolution in range, and the range at which delays repeat.
    """

    array: ArrayGeometry
    paths: Paths
    event: NDArray[np.intp]
    cell_m: float
    unambiguous_m: float

    @property
    def measures(self) -> int:
        """Angles a frame."""
        return self.paths.across.shape[1]


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


def place(heard: Sequence[Heard], position: Floats, clock: Clock, clocks_only: bool = False) -> list[Placed]:
    """Poses and offsets of all arrays.

    Parameters
    ----------
    heard
        What each has heard.
    position
        World positions (E, 3) of the UEs in the transmissions.
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
    _, where = np.unique(np.round(position, 2), axis=0, return_inverse=True)
    fit = _Fit(heard, position, where.reshape(-1), clock, clocks_only)
    for b in range(len(heard)):
        fit.check(b)
        fit.start(b)
    fit.start_offsets()
    fit.polish()
    return [fit.told(b) for b in range(len(heard))]


class _Fit:
    """The pose (middle and rotation) and offset of every array while they are looked for."""

    def __init__(
        self,
        heard: Sequence[Heard],
        position: Floats,
        where: NDArray[np.intp],
        clock: Clock,
        clocks_only: bool,
    ) -> None:
        self._heard, self._position, self._where, self._clock = heard, position, where, clock
        self._middle = [one.array.centre_m for one in heard]
        self._frame = [one.array.frame for one in heard]
        self._offset = np.zeros(len(heard))
        self._scale = np.ones((len(heard), 2))
        self._weight = [np.ones(len(one.event)) for one in heard]
        self._free: list[list[int]] = []
        for b, one in enumerate(heard):
            free = [] if clocks_only else [0, 1, 2, *((4, 5) if one.measures == 1 else (3, 4, 5))]
            if clock == "shared" or (clock == "offset" and b):
                free.append(OFFSET)
            self._free.append(free)

    def check(self, b: int) -> None:
        """Whether there are places enough, and not on one line."""
        name = self._heard[b].array.name
        places = np.unique(self._where[self._heard[b].event])
        needed = LEAST_PLACES if 0 in self._free[b] else 1
        if len(places) < needed:
            raise ValueError(
                f"array {name} has heard UEs at {len(places)} known places; a pose takes {needed} or more "
                "(its clock alone, with --clocks-only, takes one)"
            )
        if needed == 1:
            return
        there = self._position[self._heard[b].event]
        size = np.linalg.svd(there - there.mean(axis=0), compute_uv=False)
        if size[1] < ON_A_LINE * size[0]:
            raise ValueError(
                f"array {name} has heard UEs on one straight line only, which leaves its pose open; "
                "add places beside that line, or use --clocks-only"
            )

    def start(self, b: int) -> None:
        """The pose and offset that most frames of an array agree with."""
        rng = np.random.default_rng(b)
        one = self._heard[b]
        count = len(one.event)
        with_offset = self._clock == "shared"
        best, cost = None, np.inf
        for n in range(TRIES if 0 in self._free[b] else 1):
            middle, frame = self._middle[b], self._frame[b]
            which = np.arange(count)
            if n:
                which = rng.choice(count, min(AT_A_TIME, count), replace=False)
                if n % 3 == 0:  # mounted another way round
                    frame = Rotation.from_euler("XYZ", rng.integers(0, 4, 3) * np.pi / 2).as_matrix() @ frame
            offset = self._typical(b, middle, frame, which) if with_offset else 0.0
            if 0 in self._free[b]:
                middle, frame, offset = self._tried(b, middle, frame, offset, which)
                offset = self._typical(b, middle, frame, np.arange(count)) if with_offset else 0.0
            off = self._off(b, middle, frame, offset)
            limits = np.append(np.full(one.measures, DOUBTFUL_RAD), DOUBTFUL_CELLS * one.cell_m)
            square = (off / limits)[:, : None if with_offset else -1] ** 2
            told = float(np.minimum(square.mean(axis=1), TUKEY).mean())
            if told < cost:
                best, cost = (middle, frame, offset), told
        assert best is not None
        self._middle[b], self._frame[b], self._offset[b] = best

    def start_offsets(self) -> None:
        """Offsets against the first array, where UEs have clocks of their own."""
        if self._clock != "offset":
            return
        late = [self._late(b, self._middle[b], self._frame[b]) for b in range(len(self._heard))]
        first = dict(zip(self._heard[0].event.tolist(), late[0].tolist(), strict=True))
        for b in range(1, len(self._heard)):
            one = self._heard[b]
            both = [k for k, event in enumerate(one.event.tolist()) if event in first]
            if not both:
                raise ValueError(
                    f"arrays {one.array.name} and {self._heard[0].array.name} have heard no transmission "
                    "in common, which their clocks could be compared by"
                )
            apart = late[b][both] - np.array([first[int(one.event[k])] for k in both])
            self._offset[b] = _mode(apart, one.unambiguous_m, one.cell_m)

    def polish(self) -> None:
        """Weighted least squares of everything at once, weights and scales taken anew in each round."""
        for number in range(ROUNDS):
            residual, jacobian, _ = self._system()
            self._reweigh(residual, annealed=max(1.0, 4.0 * 0.7**number))
            residual, jacobian, _ = self._system()
            step = np.linalg.lstsq(jacobian, -residual, rcond=1e-9)[0]
            self._move(step)
            if number > 12 and np.abs(step).max(initial=0.0) < 1e-7:
                break

    def told(self, b: int) -> Placed:
        """What was found of an array.

        Raises
        ------
        ValueError
            If too little fits one pose, or leaves it open.
        """
        one = self._heard[b]
        name = one.array.name
        fits = float((self._weight[b] > 0.05).mean())
        if fits < LEAST_FIT:
            raise ValueError(
                f"array {name}: only {100 * fits:.0f} % of its frames fit one pose; does it see the UEs, "
                "and are their places right?"
            )
        std = self._deviations()[b]
        frame = self._frame[b]
        if 0 in self._free[b]:
            if std[:3].max() > LOOSE_M or std[3:6].max() > LOOSE_RAD:
                raise ValueError(
                    f"array {name}: these places leave its pose open by {std[:3].max():.1f} m and "
                    f"{np.degrees(std[3:6].max()):.0f} degrees; add places in other directions and distances, "
                    "or use --clocks-only"
                )
        light = one.array.light_speed_m_s
        placement = Placement(name)
        if self._clock != "own":
            offset = float(self._offset[b] / light) + 0.0
            placement = replace(placement, offset_s=offset, offset_std_s=float(std[OFFSET] / light))
        moved, turned = 0.0, 0.0
        if 0 in self._free[b]:
            own = (one.array.centre_m - np.asarray(one.array.position_m)) @ one.array.frame.T
            placement = replace(
                placement,
                position_m=_vector(self._middle[b] - own @ frame),
                axis=_vector(frame[0]),
                broadside=_vector(frame[2]),
                position_std_m=_vector(std[:3]),
                turn_std_rad=_vector(std[3:6]),
            )
            moved = float(np.linalg.norm(self._middle[b] - one.array.centre_m))
            turned = float(Rotation.from_matrix(frame @ one.array.frame.T).magnitude())
        places = len(np.unique(self._where[one.event]))
        return Placed(placement, fits, len(one.event), places, moved, turned)

    def _late(self, b: int, middle: Floats, frame: Floats) -> Floats:
        """By how much (K,) each path is longer than the way."""
        one = self._heard[b]
        way = np.linalg.norm(self._position[one.event] - middle, axis=1)
        return _wrapped(one.paths.length_m - way, one.unambiguous_m)

    def _typical(self, b: int, middle: Floats, frame: Floats, which: NDArray[np.intp]) -> float:
        one = self._heard[b]
        return _mode(self._late(b, middle, frame)[which], one.unambiguous_m, one.cell_m)

    def _off(self, b: int, middle: Floats, frame: Floats, offset: float) -> Floats:
        """By how much angles and lengths (K, A + 1) are other than the paths'."""
        one = self._heard[b]
        own = (self._position[one.event] - middle) @ frame.T
        way = np.linalg.norm(own, axis=1)
        unit = own / np.maximum(way, 1e-9)[:, None]
        if one.measures == 1:
            angles = (np.arcsin(np.clip(unit[:, 0], -1, 1)) - np.arcsin(one.paths.direction[:, 0]))[:, None]
        else:
            across = np.einsum("kax,kx->ka", one.paths.across, unit)
            along = np.einsum("kx,kx->k", one.paths.direction, unit)
            sine = np.linalg.norm(across, axis=1)
            angle = np.arctan2(sine, along)
            angles = across * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[:, None]
        far = _wrapped(way + offset - one.paths.length_m, one.unambiguous_m)
        return np.column_stack([angles, far])

    def _slopes(self, b: int, middle: Floats, frame: Floats, offset: float) -> Floats:
        """Derivatives (K, A + 1, 7) of `_off` by the array's parameters."""
        found = []
        for n in range(POSE + 1):
            both = []
            for sign in (_STEP, -_STEP):
                move = np.zeros(POSE + 1)
                move[n] = sign
                both.append(self._off(b, *_moved(middle, frame, offset, move)))
            found.append((both[0] - both[1]) / (2 * _STEP))
        return np.stack(found, axis=2)

    def _tried(
        self, b: int, middle: Floats, frame: Floats, offset: float, which: NDArray[np.intp]
    ) -> tuple[Floats, Floats, float]:
        """The pose after some damped steps by few frames."""
        one = self._heard[b]
        free = [n for n in self._free[b] if n != OFFSET or self._clock == "shared"]
        scale = np.append(np.full(one.measures, DOUBTFUL_RAD), DOUBTFUL_CELLS * one.cell_m)
        rows = slice(None) if self._clock == "shared" else slice(0, one.measures)
        prior = np.diag(np.array([*[0.3] * 3, *[0.3] * 3, 0.0])[free])
        for _ in range(TRY_STEPS):
            off = (self._off(b, middle, frame, offset) / scale)[which][:, rows]
            slopes = (self._slopes(b, middle, frame, offset) / scale[:, None])[which][:, rows][:, :, free]
            a, r = slopes.reshape(-1, len(free)), off.reshape(-1)
            move = np.zeros(POSE + 1)
            move[free] = np.clip(np.linalg.lstsq(a.T @ a + prior, -a.T @ r, rcond=None)[0], -1.0, 1.0)
            middle, frame, offset = _moved(middle, frame, offset, move)
        return middle, frame, offset

    def _whitened(self, b: int) -> tuple[Floats, Floats]:
        """Residuals (K, A + 1) in their deviations, and slopes (K, A + 1, 7)."""
        one = self._heard[b]
        state = self._middle[b], self._frame[b], float(self._offset[b])
        off, slopes = self._off(b, *state), self._slopes(b, *state)
        white = np.zeros((len(off), one.measures + 1, one.measures + 1))
        white[:, :-1, :-1] = np.linalg.inv(np.linalg.cholesky(one.paths.angle_cov))
        white[:, -1, -1] = 1 / np.sqrt(one.paths.length_var)
        white /= np.append(np.full(one.measures, self._scale[b, 0]), self._scale[b, 1])[:, None]
        if self._clock == "own":
            white[:, -1] = 0
        return np.einsum("kij,kj->ki", white, off), np.einsum("kij,kjp->kip", white, slopes)

    def _system(self) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Weighted residuals (M,) and slopes (M, P) of all arrays, and the place (M,) that each is of."""
        width = sum(map(len, self._free))
        residuals, jacobians, events, delays = [], [], [], []
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
        residual, jacobian = np.concatenate(residuals), np.concatenate(jacobians)
        event, delay = np.concatenate(events), np.concatenate(delays)
        if self._clock == "offset":
            residual, jacobian = _without_own_clocks(residual, jacobian, event, delay)
        return residual, jacobian, self._where[event]

    def _reweigh(self, residual: Floats, annealed: float) -> None:
        """Tukey's weights by the residuals of each frame in deviations that they show themselves."""
        start = 0
        for b, one in enumerate(self._heard):
            width = one.measures + 1
            count = len(one.event)
            r = residual[start : start + count * width].reshape(count, width)
            start += count * width
            r = r / np.sqrt(np.maximum(self._weight[b], 1e-12))[:, None]
            r = r * np.append(np.full(one.measures, self._scale[b, 0]), self._scale[b, 1])
            seen = self._weight[b] > 1e-6
            seen = seen if seen.mean() > 0.5 else np.ones(count, np.bool_)
            for kind, part in enumerate((r[:, :-1], r[:, -1:])):
                mad = 1.4826 * float(np.median(np.abs(part[seen])))
                self._scale[b, kind] = max(1.0, mad)
            d = r / np.append(np.full(one.measures, self._scale[b, 0]), self._scale[b, 1])
            size = np.sqrt(np.max(d * d, axis=1)) / (TUKEY * annealed)
            self._weight[b] = np.where(size < 1, (1 - size**2) ** 2, 0.0) + 1e-12

    def _move(self, step: Floats) -> None:
        start = 0
        for b, free in enumerate(self._free):
            move = np.zeros(POSE + 1)
            move[free] = np.clip(step[start : start + len(free)], -0.5, 0.5)
            start += len(free)
            state = self._middle[b], self._frame[b], float(self._offset[b])
            self._middle[b], self._frame[b], self._offset[b] = _moved(*state, move)

    def _deviations(self) -> Floats:
        """Of all parameters, (B, 7); 0 of those that are as described."""
        residual, jacobian, where = self._system()
        normal = jacobian.T @ jacobian
        inverse = np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
        scores = np.zeros((int(self._where.max()) + 1, jacobian.shape[1]))
        np.add.at(scores, where, jacobian * residual[:, None])
        places = max(2, int((np.abs(scores).max(axis=1, initial=0.0) > 0).sum()))
        count, width = (np.abs(residual) > 1e-5).sum(), jacobian.shape[1]
        more = places / (places - 1) * max(1.0, count / max(count - width, 1))
        sandwich = more * inverse @ (scores.T @ scores) @ inverse
        variance = np.maximum(np.diag(sandwich), np.diag(inverse))
        found, start = np.zeros((len(self._heard), POSE + 1)), 0
        for b, free in enumerate(self._free):
            found[b, free] = np.sqrt(variance[start : start + len(free)])
            start += len(free)
        return found


def _moved(middle: Floats, frame: Floats, offset: float, move: Floats) -> tuple[Floats, Floats, float]:
    """A state after small changes (7,): own axes turn about themselves."""
    turned: Floats = Rotation.from_rotvec(move[3:6]).as_matrix().T @ frame
    return middle + move[:3], turned, offset + float(move[6])


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


def _wrapped(length: Floats, period: float) -> Floats:
    wrapped: Floats = (length + period / 2) % period - period / 2
    return wrapped


def _mode(values: Floats, period: float, width: float) -> float:
    """Where most of the values (K,), which repeat with `period`, are within `width` of each other."""
    apart = np.abs(_wrapped(values[:, None] - values, period))
    centre = values[int(np.minimum(apart, width).sum(axis=1).argmin())]
    near = _wrapped(values - centre, period)
    return float(_wrapped(centre + np.median(near[np.abs(near) <= width]), period))


def _vector(values: Floats) -> Vector:
    x, y, z = (float(v) + 0.0 for v in values)
    return (x, y, z)
