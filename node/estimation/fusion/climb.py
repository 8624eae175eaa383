"""From coarse points to the tops of the likelihood nearby: finer grids, then Newton's method."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.fusion.site import Floats

Singles = NDArray[np.float32]

LEVELS = 3
"""Finer grids, each of half the step before."""
NEWTON_STEPS = 8
SETTLED = 1e-4
"""Newton's method ends when no top moves by more than this part of the coarse step."""
STENCIL = 1 / 16
"""Newton's derivatives are differences over this part of the coarse step."""


class Scores(Protocol):
    """What is climbed."""

    def score(self, points: Floats, offset: Floats | None, sharp: bool) -> Singles:
        """Log likelihoods (U, Q) of positions (U, Q, 3) and offsets (U, Q)."""


@dataclass(frozen=True)
class Peaks:
    """Tops (U, M): positions (U, M, 3), offsets or None, scores, minus the Hessians (U, M, d, d) of `fit`."""

    points: Floats
    offset: Floats | None
    broad: Floats
    fit: Floats
    curvature: Floats


class Climb:
    """Climbs from points (U, M) at once; coordinates are the area's, then the offset if it is searched."""

    def __init__(self, basis: Floats, step: float, offset: bool) -> None:
        self._basis, self._step, self._offset = basis, step, offset
        d = len(basis) + offset
        self._cube = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=d)))
        self._pairs = list(itertools.combinations(range(d), 2))
        eye = np.eye(d)
        self._star = np.array([np.zeros(d), *eye, *-eye, *(eye[i] + eye[j] for i, j in self._pairs)])

    def __call__(self, view: Scores, start: Floats, offset: Floats | None) -> Peaks:
        """The tops above `start` (U, M, 3) and their `offset` (U, M)."""
        users, modes = start.shape[:2]
        at = np.zeros((users, modes, len(self._cube[0])))
        if offset is not None:
            at[..., -1] = offset
        step = 2 * self._step
        for _ in range(LEVELS):
            step /= 2
            tried = at[:, :, None] + step * self._cube
            score = self._score(view, start, tried, sharp=False)
            best = score.argmax(axis=2)
            at = np.take_along_axis(tried, best[:, :, None, None], axis=2)[:, :, 0]
        broad = score.max(axis=2).astype(np.float64)
        at, fit, curvature = self._newton(view, start, at)
        points = start + at[..., : len(self._basis)] @ self._basis
        return Peaks(points, at[..., -1] if self._offset else None, broad, fit, curvature)

    def _newton(self, view: Scores, start: Floats, at: Floats) -> tuple[Floats, Floats, Floats]:
        """Newton's method in a trust region; the Hessians are those of the last look."""
        radius = np.full(at.shape[:2], self._step / 2)
        delta = self._step * STENCIL
        score, slope, curvature = self._look(view, start, at, delta)
        for _ in range(NEWTON_STEPS):
            move = _bounded(slope, curvature, radius)
            there = self._look(view, start, at + move, delta)
            better = there[0] > score
            at = np.where(better[..., None], at + move, at)
            score = np.where(better, there[0], score)
            slope = np.where(better[..., None], there[1], slope)
            curvature = np.where(better[..., None, None], there[2], curvature)
            radius = np.where(better, 2 * radius, radius / 4)
            if not (better & (np.linalg.norm(move, axis=2) > SETTLED * self._step)).any():
                break
        return at, score, curvature

    def _look(self, view: Scores, start: Floats, at: Floats, delta: float) -> tuple[Floats, Floats, Floats]:
        """Score (U, M), its gradient (U, M, d), and minus its Hessian (U, M, d, d), by differences."""
        d = at.shape[2]
        s = self._score(view, start, at[:, :, None] + delta * self._star, sharp=True).astype(np.float64)
        centre, plus, minus = s[..., :1], s[..., 1 : d + 1], s[..., d + 1 : 2 * d + 1]
        curvature = np.empty((*at.shape, d))
        for i in range(d):
            curvature[..., i, i] = 2 * s[..., 0] - plus[..., i] - minus[..., i]
        for n, (i, j) in enumerate(self._pairs):
            cross = s[..., 0] - plus[..., i] - plus[..., j] + s[..., 2 * d + 1 + n]
            curvature[..., i, j] = curvature[..., j, i] = -cross
        return centre[..., 0], (plus - minus) / (2 * delta), curvature / delta**2

    def _score(self, view: Scores, start: Floats, at: Floats, sharp: bool) -> Singles:
        """Scores (U, M, Q) at coordinates (U, M, Q, d) from `start`."""
        points = start[:, :, None] + at[..., : len(self._basis)] @ self._basis
        flat = points.reshape(len(points), -1, 3)
        offset = at[..., -1].reshape(len(points), -1) if self._offset else None
        return view.score(flat, offset, sharp).reshape(at.shape[:3])


def _bounded(slope: Floats, curvature: Floats, radius: Floats) -> Floats:
    """Newton steps (U, M, d) where minus the Hessian is positive, uphill where it is not, within `radius`."""
    value, vector = np.linalg.eigh(curvature)
    least = 1e-3 * np.abs(value).max(axis=-1, keepdims=True) + 1e-9
    step = np.einsum("umij,umkj,umk,umj->umi", vector, vector, slope, 1 / np.maximum(np.abs(value), least))
    length = np.linalg.norm(step, axis=-1)
    bounded: Floats = step * np.minimum(1, radius / np.maximum(length, 1e-12))[..., None]
    return bounded
