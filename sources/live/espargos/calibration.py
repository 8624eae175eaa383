"""What each sensor of a board adds to delay and phase, from packets that the board sends to itself.

On request the board's switch connects all sensors to one reference signal over known traces of the circuit
board. Of each sensor this leaves the offset of its clock, the phase of its oscillator path, and the delay of
its trace, which a signal from an antenna does not see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import SPEED_OF_LIGHT
from chachart.sources.live.espargos.cluster import Cluster
from chachart.sources.live.espargos.message import SUBCARRIER_SPACING_HZ, TONES

TRACES_M = np.array([0.0604561, 0.0373554, 0.1070395, 0.1770280, 0.1076842, 0.0554654, 0.0806678, 0.1462569])
"""Length of each sensor's calibration trace, row by row as the board's layout has them."""
PERMITTIVITY = 4.3
TRACE_WIDTH_M, TRACE_HEIGHT_M = 0.2e-3, 0.119e-3
FEWEST = 8
"""Packets that a calibration takes at least."""
ANTENNA_OF_PLACE = np.array([4, 5, 6, 7, 0, 1, 2, 3])
"""The sensor at each place of the board's layout, row 0 first: sensors 0 to 3 are row 1."""


def trace_delay_s() -> NDArray[np.float64]:
    """Delay (8,) of each sensor's calibration trace, a microstrip line, by sensor number."""
    ratio = 12 * TRACE_HEIGHT_M / TRACE_WIDTH_M
    effective = (PERMITTIVITY + 1) / 2 + (PERMITTIVITY - 1) / 2 / np.sqrt(1 + ratio)
    by_sensor = np.empty(8)
    by_sensor[ANTENNA_OF_PLACE] = TRACES_M
    delay: NDArray[np.float64] = by_sensor * np.sqrt(effective) / SPEED_OF_LIGHT
    return delay


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What to multiply aligned frames with.

    Attributes
    ----------
    factor
        complex64 (antennas, tones).
    delay_s, phase_rad
        (antennas,): offsets that were found, against the first sensor.
    packets
        How many reference packets stand behind it.
    """

    factor: NDArray[np.complex64]
    delay_s: NDArray[np.float64]
    phase_rad: NDArray[np.float64]
    packets: int


def find(clusters: list[Cluster], centre_hz: float, path_s: NDArray[np.float64]) -> Correction:
    """The correction from reference packets.

    Parameters
    ----------
    clusters
        Reference packets, all antennas each.
    centre_hz
        Middle of the radio's channel.
    path_s
        (antennas,): delay from the common reference to each sensor.
    """
    tones = clusters[0].tones()
    measured = np.stack([cluster.csi for cluster in clusters]).astype(np.complex128)
    lag = measured[:, :, 1:] * measured[:, :, :-1].conj()
    near = np.diff(TONES) == 2  # not across the middle
    start = np.angle(lag[:, :, near].sum(axis=2)) / (2 * np.pi * 2 * SUBCARRIER_SPACING_HZ)
    clock = np.stack([cluster.delay_s for cluster in clusters])
    offset = (clock - start).mean(axis=0)
    delay = offset - offset[0]
    flat = measured * np.exp(-2j * np.pi * SUBCARRIER_SPACING_HZ * start[:, :, None] * tones)
    response = flat.sum(axis=2)
    phase = np.angle((response * response[:, :1].conj()).sum(axis=0))
    offset_hz = SUBCARRIER_SPACING_HZ * tones
    turns = phase[:, None] - 2 * np.pi * delay[:, None] * offset_hz
    turns = turns + 2 * np.pi * path_s[:, None] * (centre_hz + offset_hz)
    return Correction(np.exp(-1j * turns).astype(np.complex64), delay, phase, len(clusters))
