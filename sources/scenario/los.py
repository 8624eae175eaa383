"""The line-of-sight channel: one spherical wave."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.scenario.phasor import over_tones, phasor


class LosChannel:
    """A spherical wave from each UE to each antenna, h = d^-r exp(-j 2 pi f d / c).

    d is the exact distance from the UE to the antenna (curved wave front, amplitude falling along the array),
    f the frequency of the subcarrier, c the array's `light_speed_m_s` and r the exponent of the amplitude (1
    in free space). Elements have their patterns; reflections are not modelled. A UE nearer than a wavelength
    to an antenna counts as one wavelength away.
    """

    def __init__(self, array: ArrayGeometry, exponent: float = 1.0) -> None:
        self.array = array
        self.exponent = exponent
        self._elements = array.element_positions()

    def csi(self, ue: NDArray[Any], position: NDArray[Any]) -> NDArray[np.complex64]:
        """Channels complex64 (K, N_R, N_S) of UEs at world positions (K, 3); which UE does not matter."""
        array = self.array
        offset = np.asarray(position, np.float64)[:, None] - self._elements
        distance = np.sqrt(np.einsum("kij,kij->ki", offset, offset))
        distance = np.maximum(distance, array.wavelength_m)
        first = phasor(-distance / array.wavelength_m)
        first *= (distance**-self.exponent).astype(np.float32)
        if array.pattern is not None:
            first *= array.pattern.gains(array.towards(position)).astype(np.complex64)
        wave = over_tones(first, distance * (array.rho_phase / (2 * np.pi)), array.tone_numbers)
        return np.ascontiguousarray(wave.transpose(1, 2, 0))
