"""Chains of a card that turn by 180 degrees from one start to the next, found and undone.

Each start's phases are held against those of the first. Where the transmitter's place is known, every chain
tells by itself. Where none is, a plane wave on a uniform line has the same phase step between all neighbours,
so the second differences of phase do not depend on where it comes from: they tell which chains have turned,
up to every other one, which is no other than a wave from elsewhere (a turn).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Phasors = NDArray[np.complex128]
Signs = NDArray[np.int64]


def second_differences(frames: NDArray[Any]) -> Phasors:
    """Phasors (N_R - 2,) of second differences of phase along a line, summed over frames (K, N_R, N_S)."""
    steps = np.einsum("kns,kns->kn", frames[:, :-1], frames[:, 1:].conj(), dtype=np.complex128)
    found: Phasors = np.sum(steps[:, :-1] * steps[:, 1:].conj(), axis=0)
    return found


def deviations(frames: NDArray[Any], expected: NDArray[Any]) -> Phasors:
    """Phasors (N_R,) by which chains are off the waves (K, N_R) they should see, relative to chain 0."""
    seen = np.einsum("kns,kn->kn", frames, expected.conj(), dtype=np.complex128)
    found: Phasors = np.sum(seen * seen[:, :1].conj(), axis=0)
    return found


def expected_waves(elements_m: NDArray[Any], position_m: NDArray[Any], wavelength_m: float) -> Phasors:
    """Spherical waves (K, N_R) at the carrier from places (K, 3) on elements (N_R, 3)."""
    distance = np.linalg.norm(elements_m - np.asarray(position_m, np.float64)[:, None], axis=2)
    waves: Phasors = np.exp(-2j * np.pi * distance / wavelength_m)
    return waves


def signs_of(reference: Phasors, start: Phasors) -> tuple[Signs, float]:
    """+1 or -1 for each chain (N_R,), and by how many radians they are off 0 or 180 degrees at most."""
    relative = start * reference.conj()
    signs = np.where(relative.real < 0, -1, 1)
    return signs, _off(relative * signs)


def blind_signs_of(reference: Phasors, start: Phasors) -> tuple[Signs, float]:
    """As `signs_of`, from second differences (N_R - 2,); chains 0 and 1 are taken as they are."""
    turned, off = signs_of(reference, start)
    signs = np.ones(len(start) + 2, np.int64)
    for n, sign in enumerate(turned.tolist()):
        signs[n + 2] = signs[n] * sign
    return signs, off


def _off(relative: Phasors) -> float:
    return float(np.abs(np.angle(relative)).max(initial=0.0))
