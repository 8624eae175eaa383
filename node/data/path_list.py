"""The few strongest paths of a frame, as chart rows carry them: the column `paths`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PATHS = 3
"""Paths in a row."""
_EACH = ("azimuth", "elevation", "range", "share", "phase")
PARTS = ("level", *(f"{name}_{n}" for n in range(1, PATHS + 1) for name in _EACH))
"""What the numbers of a row are called."""
FAR_M = 1e5
"""Where it is not known how far a UE is, its waves are as good as plane."""

NEAREST_M = 0.3
"""No wave's centre is taken to be nearer."""

_STEP_RAD, _STEP_M = 1e-4, 1e-2


@dataclass(frozen=True)
class PathList:
    """Paths of K frames, each a wave with one direction, delay and amplitude.

    Attributes
    ----------
    level_db
        Mean power of a sample of the frame (K,), 20 log10 of the amplitude.
    direction
        Own unit vectors (K, PATHS, 3) along (right, up, normal); of a line, in the plane of right and normal.
    length_m
        Delays times the speed of light (K, PATHS), from the middle of the array.
    amplitude
        Complex amplitudes (K, PATHS) there, at the carrier, against the frame's level.
    """

    level_db: Floats
    direction: Floats
    length_m: Floats
    amplitude: NDArray[np.complex128]

    def packed(self) -> Floats:
        """The numbers of the column (K, len(PARTS)); a path that is not there has the share 0."""
        x, y, z = np.moveaxis(self.direction, -1, 0)
        each = np.stack(
            [
                np.arctan2(x, z),
                np.arcsin(np.clip(y, -1, 1)),
                self.length_m,
                np.abs(self.amplitude) ** 2,
                np.angle(self.amplitude),
            ],
            axis=-1,
        )
        return np.concatenate([self.level_db[:, None], each.reshape(len(each), -1)], axis=1)

    @classmethod
    def unpacked(cls, column: Floats) -> Self:
        """What `packed` was made of."""
        azimuth, elevation, length, share, phase = np.moveaxis(
            column[:, 1:].reshape(-1, PATHS, len(_EACH)), -1, 0
        )
        flat = np.cos(elevation)
        direction = np.stack([flat * np.sin(azimuth), np.sin(elevation), flat * np.cos(azimuth)], axis=-1)
        amplitude = np.sqrt(np.maximum(share, 0.0)) * np.exp(1j * phase)
        return cls(column[:, 0], direction, length, amplitude)

    def moved(self) -> Iterator[Self]:
        """The paths a little further: in direction, one way and the other, and in length."""
        aside = np.cross((0.0, 1.0, 0.0), self.direction)
        for way in (aside, np.cross(self.direction, aside)):
            yield replace(self, direction=self.direction + _STEP_RAD * way)
        yield replace(self, length_m=self.length_m + _STEP_M)

    def waves(
        self, elements: Floats, far_m: Floats, frequencies_hz: Floats, carrier_hz: float, light_m_s: float
    ) -> NDArray[np.complex128]:
        """The waves (K, PATHS, N, S) of these directions and delays, of amplitude 1, phase 0 in the middle.

        Parameters
        ----------
        elements
            Own places (N, 3) of the elements, from the middle of the array.
        far_m
            Radius (K,) of the waves' curvature.
        frequencies_hz, carrier_hz
            Of the tones (S,), and that at which phases are counted.
        light_m_s
            Speed of light.
        """
        centres = self.direction * far_m[:, None, None]
        detour = np.linalg.norm(centres[:, :, None] - elements, axis=3) - far_m[:, None, None]
        cycles = detour[..., None] * frequencies_hz
        cycles += self.length_m[:, :, None, None] * (frequencies_hz - carrier_hz)
        return np.asarray(np.exp(-2j * np.pi * ((cycles / light_m_s) % 1.0)))
