"""The strongest path of single frames: its direction in the array's own frame, its delay, and how surely.

The spectrum of plane waves says roughly where it is, then the exact matched filter's power P, of waves from
so far as the UE is, is climbed by Newton's method. With noise of variance s^2 a sample, P / s^2 is the
log likelihood of one path, whose inverse curvature is the covariance.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.received import Received
from chachart.node.estimation.fusion.receiver import Receiver
from chachart.node.estimation.fusion.site import Complex, Floats

CHUNK = 64
GRID = 4096
"""Directions all round that the coarse search tells apart."""
STEPS = 6
PART = 1 / 16
"""Derivatives are differences over this part of a beam, and of a delay's cell."""
LEAST_NEAR_M = 0.3


@dataclass(frozen=True)
class Paths:
    """The strongest path of K frames.

    Attributes
    ----------
    direction
        Own unit vectors (K, 3) along (right, up, normal); of a line, in the plane of right and normal.
    across
        Own unit vectors (K, A, 3) that angles are counted along; a line has one, others two.
    angle_cov
        Covariance of the angles (K, A, A), rad^2.
    length_m, length_var
        Delay times speed of light (K,), within 0 and the unambiguous range, and its variance.
    share
        Of the frame's energy, what the path explains (K,).
    """

    direction: Floats
    across: Floats
    angle_cov: Floats
    length_m: Floats
    length_var: Floats
    share: Floats

    def some(self, which: NDArray[np.intp]) -> Self:
        """Only these frames."""
        return type(self)(*(getattr(self, field.name)[which] for field in fields(self)))

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """All of several, one after the other."""
        return cls(*(np.concatenate([getattr(p, field.name) for p in parts]) for field in fields(cls)))


class Pathfinder:
    """Finds strongest paths of an array's frames.

    Raises
    ------
    ValueError
        If the array is none that can be fused; the message begins with its name.
    """

    def __init__(self, array: ArrayGeometry) -> None:
        flat = replace(array, axis=(1.0, 0.0, 0.0), broadside=(0.0, 0.0, 1.0), position_m=(0.0, 0.0, 0.0))
        middle = flat.centre_m
        flat = replace(flat, position_m=(-float(middle[0]), -float(middle[1]), -float(middle[2])))
        self._receiver = Receiver(flat)
        self.site = self._receiver.site
        self.angles = 1 if array.is_line else 2
        around = self.site.elements - self.site.centre
        aperture = float(np.linalg.norm(np.ptp(around, axis=0)))
        self.beam_rad = min(1.0, self.site.wavelength_m / max(aperture, 1e-9))
        self._beams, self._directions = self._grid()

    def __call__(self, csi: Complex, far_m: Floats) -> Paths:
        """Of frames (K, N_R, N_S) as they come, of UEs about `far_m` (K,) away."""
        parts = []
        for i in range(0, len(csi), CHUNK):
            part = slice(i, i + CHUNK)
            parts.append(self.strongest(self.prepared(csi[part]), far_m[part]))
        return Paths.concatenate(parts)

    def prepared(self, csi: Complex) -> Complex:
        """Frames (K, N_R, N_S) as `strongest` takes them, see `Receiver.prepared`."""
        return self._receiver.prepared(csi)

    def _grid(self) -> tuple[Complex, Floats]:
        """Beams of the coarse search (D, N), and their own directions (D, 3)."""
        if self.angles == 1:
            angle = np.linspace(-np.pi / 2, np.pi / 2, GRID // 4)
            points = np.stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)], axis=1)
        else:
            n = np.arange(GRID) + 0.5
            z, turn = 1 - 2 * n / GRID, np.pi * (1 + np.sqrt(5)) * n
            level = np.sqrt(1 - z * z)
            points = np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=1)
            points = points[self.site.ranges(points)[1]]
        beams, which = self.site.beams(points)
        first = np.unique(which, return_index=True)[1]
        return beams, points[first]

    def strongest(self, csi: Complex, far_m: Floats) -> Paths:
        """As calling it, of few prepared frames."""
        received, far_m = Received(self.site, csi), np.maximum(far_m, LEAST_NEAR_M)
        rows = np.arange(len(far_m))
        spectrum = received.spectrum(self._beams)
        delays = spectrum.shape[2]
        top = spectrum.reshape(len(rows), -1).argmax(axis=1)
        direction = self._directions[top // delays]
        length = (top % delays) * (self.site.unambiguous_m / delays)
        scale = np.append(np.full(self.angles, self.beam_rad), self.site.cell_m) * PART
        climbing = _Climbing(received, far_m, scale)
        across = self._across(direction)
        score = climbing.power(direction[:, None], length[:, None])[:, 0]
        for _ in range(STEPS):
            _, slope, curvature = climbing.look(direction, across, length)
            value, vector = np.linalg.eigh(curvature)
            least = 1e-2 * np.abs(value).max(axis=1, keepdims=True) + 1e-30
            step = np.einsum("kij,klj,kl,kj->ki", vector, vector, slope, 1 / np.maximum(np.abs(value), least))
            step *= np.minimum(1, 4 / np.maximum(np.linalg.norm(step, axis=1), 1e-12))[:, None]
            moved = _turned(direction, across, step[:, : self.angles] * scale[:-1])
            longer = length + step[:, -1] * scale[-1]
            now = climbing.power(moved[:, None], longer[:, None])[:, 0]
            better = now > score
            direction = np.where(better[:, None], moved, direction)
            length = np.where(better, longer, length)
            score = np.where(better, now, score)
            across = self._across(direction)
            if not better.any():
                break
        _, _, curvature = climbing.look(direction, across, length)
        energy = received.energy.astype(np.float64)
        noise = np.maximum(energy - score, 1e-6 * energy) / (self.site.samples - 1)
        value, vector = np.linalg.eigh(curvature)
        inverse = 1 / np.maximum(value, 1e-6 * np.abs(value).max(axis=1, keepdims=True) + 1e-30)
        cov = np.einsum("kij,kj,klj->kil", vector, inverse, vector) * noise[:, None, None]
        cov *= scale[:, None] * scale
        a = self.angles
        length %= self.site.unambiguous_m
        return Paths(direction, across, cov[:, :a, :a], length, cov[:, a, a], score / energy)

    def _across(self, direction: Floats) -> Floats:
        """Unit vectors (K, A, 3) orthogonal to directions (K, 3)."""
        if self.angles == 1:
            x, z = direction[:, 0], direction[:, 2]
            return np.stack([z, np.zeros(len(x)), -x], axis=1)[:, None]
        helper = np.where(np.abs(direction[:, 1:2]) < 0.9, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
        first = np.cross(helper, direction)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        return np.stack([first, np.cross(direction, first)], axis=1)


class _Climbing:
    """Power of one path over direction and delay, in units of `scale` (A + 1,)."""

    def __init__(self, received: Received, far_m: Floats, scale: Floats) -> None:
        self._received, self._far, self._scale = received, far_m, scale
        d = len(scale)
        eye = np.eye(d)
        self._pairs = list(itertools.combinations(range(d), 2))
        self._star = np.array([np.zeros(d), *eye, *-eye, *(eye[i] + eye[j] for i, j in self._pairs)])

    def power(self, direction: Floats, length: Floats) -> Floats:
        """Of directions (K, Q, 3) and delays (K, Q), (K, Q)."""
        points = direction * self._far[:, None, None]
        return self._received.power(points, length - self._far[:, None]).astype(np.float64)

    def look(self, direction: Floats, across: Floats, length: Floats) -> tuple[Floats, Floats, Floats]:
        """Power (K,), its slope (K, d), and minus its Hessian (K, d, d), by differences."""
        d, a = len(self._scale), across.shape[1]
        moves = self._star * self._scale
        points = direction[:, None] + np.einsum("qa,kax->kqx", moves[:, :a], across)
        points /= np.linalg.norm(points, axis=2, keepdims=True)
        s = self.power(points, length[:, None] + moves[:, a])
        plus, minus = s[:, 1 : d + 1], s[:, d + 1 : 2 * d + 1]
        curvature = np.empty((len(s), d, d))
        for i in range(d):
            curvature[:, i, i] = 2 * s[:, 0] - plus[:, i] - minus[:, i]
        for n, (i, j) in enumerate(self._pairs):
            cross = s[:, 0] - plus[:, i] - plus[:, j] + s[:, 2 * d + 1 + n]
            curvature[:, i, j] = curvature[:, j, i] = -cross
        return s[:, 0], (plus - minus) / 2, curvature


def _turned(direction: Floats, across: Floats, angles: Floats) -> Floats:
    """Directions (K, 3) moved by small angles (K, A) along `across`."""
    moved = direction + np.einsum("ka,kax->kx", angles, across)
    turned: Floats = moved / np.linalg.norm(moved, axis=1, keepdims=True)
    return turned
