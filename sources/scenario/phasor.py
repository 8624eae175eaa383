"""Unit phasors and geometric progressions of them, in single precision but for the phase."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def phasor(cycles: NDArray[np.float64]) -> NDArray[np.complex64]:
    """exp(j 2 pi cycles) in complex64; whole cycles are taken off in double precision before."""
    angle = (2 * np.pi * (cycles - np.rint(cycles))).astype(np.float32)
    out = np.empty(angle.shape, np.complex64)
    np.cos(angle, out=out.real)
    np.sin(angle, out=out.imag)
    return out


def progression(first: NDArray[Any], step_cycles: NDArray[np.float64], n: int) -> NDArray[np.complex64]:
    """first * exp(j 2 pi k step_cycles) for k = 0..n-1 along a new first axis, (n, ...) complex64.

    Made by doubling: log2(n) products instead of n exponentials, each factor from its exact phase. The new
    axis comes first to keep the products' inner loops long.
    """
    out = np.empty((n, *first.shape), np.complex64)
    out[0] = first
    done = 1
    while done < n:
        more = min(done, n - done)
        np.multiply(out[:more], phasor(done * step_cycles), out=out[done : done + more])
        done += more
    return out


def over_tones(
    first: NDArray[Any], step_cycles: NDArray[np.float64], tones: NDArray[np.int64]
) -> NDArray[np.complex64]:
    """first * exp(j 2 pi t step_cycles) for ascending tone numbers t along a new first axis, complex64."""
    steps = np.diff(tones)
    first = first * phasor(tones[0] * step_cycles) if tones[0] else first
    if (steps == steps[:1]).all():
        return progression(first, step_cycles * (steps[0] if len(steps) else 1), len(tones))
    out = np.empty((len(tones), *first.shape), np.complex64)
    for n, tone in enumerate(tones - tones[0]):
        np.multiply(first, phasor(tone * step_cycles), out=out[n])
    return out
