"""A UE's frames as a picture over angle and range, with the paths that stand out: for people to look at.

The picture is a beamformer's: P(phi, rho) = mean_k |a(phi)^H H_k e(rho)*|^2, with Hann windows over elements
and subcarriers, whose side lobes (-31 dB) pass for no path.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry

ANGLES = 73
RANGES = 96
LOWEST_DB = -30
PATH_DB = -15.0
MOST_PATHS = 6


def angle_delay(csi: NDArray[np.complex64], array: ArrayGeometry) -> dict[str, Any]:
    """The picture of frames (K, antennas, subcarriers), which must be calibrated, as plain lists.

    `angle_rad` is measured from the array's right, as a line's theta, in the plane that holds its normal;
    `rho_m` reaches as far as ranges are unambiguous. `db` (angles, ranges) is against the highest, whole
    numbers from `LOWEST_DB`; `paths` are its peaks above `PATH_DB`, [angle, rho, dB] each, strongest first.
    """
    antennas, tones = array.live_antennas, array.live_tones
    frames = np.nan_to_num(csi[:, antennas][:, :, tones]).astype(np.complex128)
    angles = np.linspace(0.0, np.pi, ANGLES)
    ranges = np.linspace(0.0, array.unambiguous_rho_m, RANGES, endpoint=False)
    towards = np.stack([np.cos(angles), np.zeros(ANGLES), np.sin(angles)])
    places = array.own_elements[antennas]
    phases = 2 * np.pi * array.middle_hz / array.light_speed_m_s * (places @ towards)
    steering = np.exp(1j * phases) * _window(_spread(places))[:, None]
    numbers = array.tone_numbers[tones]
    delays = np.exp(1j * array.rho_phase * np.outer(numbers, ranges)) * _window(numbers)[:, None]
    beams = np.einsum("na,kns,sr->kar", steering.conj(), frames, delays.conj(), optimize=True)
    power = (np.abs(beams) ** 2).mean(axis=0)
    top = power.max()
    level = np.maximum(10 * np.log10(np.maximum(power, 1e-30) / max(top, 1e-30)), LOWEST_DB)
    return {
        "angle_rad": angles.round(4).tolist(),
        "rho_m": ranges.round(2).tolist(),
        "db": level.round().astype(int).tolist(),
        "paths": _peaks(level, angles, ranges) if top > 0 else [],
    }


def _spread(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where elements are along the direction in which they spread most."""
    centred = places - places.mean(axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    along: NDArray[np.float64] = centred @ directions[0]
    return along


def _window(places: NDArray[Any]) -> NDArray[np.float64]:
    """A Hann window over places that need not be even; not quite 0 at its ends."""
    span = np.ptp(places)
    if not span:
        return np.ones(len(places))
    at = (places - places.min() + span / (2 * len(places))) / (span * (1 + 1 / len(places)))
    window: NDArray[np.float64] = np.sin(np.pi * at) ** 2
    return window


def _peaks(
    level: NDArray[np.float64], angles: NDArray[np.float64], ranges: NDArray[np.float64]
) -> list[list[float]]:
    padded = np.pad(np.pad(level, ((1, 1), (0, 0)), constant_values=-np.inf), ((0, 0), (1, 1)), mode="wrap")
    around = [
        padded[1 + i : 1 + i + level.shape[0], 1 + j : 1 + j + level.shape[1]]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        if (i, j) != (0, 0)
    ]
    found = np.argwhere((level >= np.maximum.reduce(around)) & (level > PATH_DB))
    order = np.argsort([-level[i, j] for i, j in found], kind="stable")[:MOST_PATHS]
    return [
        [round(float(angles[i]), 4), round(float(ranges[j]), 2), round(float(level[i, j]), 1)]
        for i, j in found[order]
    ]
