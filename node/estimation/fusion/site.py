"""What fusion knows of an array: where its elements are, which way it looks, and its tones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import SPEED_OF_LIGHT

Floats = NDArray[np.float64]
Complex = NDArray[np.complex64]

OVERSAMPLING = 4
"""Delays a resolution cell, so that a look-up between them loses at most 2 % of a peak."""
BINS_A_BEAM = 4.0
"""Directions a beam width (wavelength by aperture) of the coarse search."""


@dataclass(frozen=True)
class Site:
    """An array as fusion sees it.

    Parameters
    ----------
    name
        Which array.
    elements
        World positions (N, 3) in metres.
    normal
        Unit vector (3,) out of its front; a position behind it explains nothing that the array receives. None
        if it hears from all sides.
    tones_hz
        Frequencies (S,) of the subcarriers, evenly spaced.
    light_speed_m_s
        Propagation speed.
    measured
        How many of the tones are measured, the others being zeros; None: all.

    Raises
    ------
    ValueError
        If shapes do not fit, or the tones are not even.
    """

    name: str
    elements: Floats
    normal: Floats | None
    tones_hz: Floats
    light_speed_m_s: float = SPEED_OF_LIGHT
    measured: int | None = None

    def __post_init__(self) -> None:
        if self.elements.ndim != 2 or self.elements.shape[1] != 3 or not len(self.elements):
            raise ValueError(f"elements must be (N, 3), not {self.elements.shape}")
        normal = self.normal
        if normal is not None and not (
            normal.shape == (3,) and np.isclose(np.linalg.norm(normal), 1.0, atol=1e-4)
        ):
            raise ValueError(f"normal must be a unit vector of 3 numbers, not {normal}")
        steps = np.diff(self.tones_hz)
        if not len(steps) or steps[0] <= 0 or not np.allclose(steps, steps[0], rtol=1e-6):
            raise ValueError("tones_hz must be at least two, rising evenly")

    @property
    def centre(self) -> Floats:
        """World position (3,) of the middle of the elements, which delays are counted from."""
        middle: Floats = self.elements.mean(axis=0)
        return middle

    @property
    def samples(self) -> int:
        """Of a frame, measured ones."""
        return len(self.elements) * (self.measured or len(self.tones_hz))

    @property
    def spacing_hz(self) -> float:
        """Between neighbouring tones."""
        return float(self.tones_hz[1] - self.tones_hz[0])

    @property
    def middle_hz(self) -> float:
        """Frequency that phases between elements are counted at."""
        return float(self.tones_hz.mean())

    @property
    def wavelength_m(self) -> float:
        """At the middle of the band."""
        return self.light_speed_m_s / self.middle_hz

    @property
    def cell_m(self) -> float:
        """Resolution in range: speed of light by bandwidth."""
        return self.light_speed_m_s / (self.spacing_hz * len(self.tones_hz))

    @property
    def unambiguous_m(self) -> float:
        """Range at which delays repeat."""
        return self.light_speed_m_s / self.spacing_hz

    def ranges(self, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Distance (...) of world positions (..., 3) from the centre, and whether they are in front."""
        offset = points - self.centre
        rho = np.sqrt(np.einsum("...i,...i->...", offset, offset))
        if self.normal is None:
            return rho, np.ones(rho.shape, np.bool_)
        return rho, offset @ self.normal > 0

    def match(self, points: Floats, rho: Floats) -> Complex:
        """Conjugate phases (..., N) of spherical waves from `points` (..., 3), `rho` (...) away."""
        cycles = np.empty((*rho.shape, len(self.elements)))
        for n, element in enumerate(self.elements):
            offset = points - element
            cycles[..., n] = np.sqrt(np.einsum("...i,...i->...", offset, offset)) - rho
        cycles /= self.wavelength_m
        return phasor(cycles)

    def beams(self, points: Floats) -> tuple[Complex, NDArray[np.intp]]:
        """Directions that tell `points` (G, 3) apart: conjugate steering (D, N), each point's one (G,)."""
        offset = points - self.centre
        direction = offset / np.linalg.norm(offset, axis=1, keepdims=True)
        around = self.elements - self.centre
        _, _, axes = np.linalg.svd(around, full_matrices=True)
        bins = np.empty((len(points), 3), np.int64)
        for i, axis in enumerate(axes):
            aperture = np.ptp(around @ axis) / self.wavelength_m
            bins[:, i] = np.round(direction @ axis * (aperture * BINS_A_BEAM))
        _, first, which = np.unique(bins, axis=0, return_index=True, return_inverse=True)
        which = which.reshape(-1)
        middle = np.stack([np.bincount(which, direction[:, i], len(first)) for i in range(3)], axis=1)
        size = np.linalg.norm(middle, axis=1, keepdims=True)
        middle = np.where(size > 1e-6, middle / np.maximum(size, 1e-6), direction[first])
        return phasor(-(middle @ around.T) / self.wavelength_m), which


def phasor(cycles: Floats) -> Complex:
    """exp(j 2 pi cycles) in single precision, from phases reduced in double."""
    angle = ((cycles - np.round(cycles)) * (2 * np.pi)).astype(np.float32)
    out = np.empty(angle.shape, np.complex64)
    np.cos(angle, out=out.real)
    np.sin(angle, out=out.imag)
    return out
