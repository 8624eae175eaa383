"""Boards, circles and elements in space, and frames that they hear, for tests of directions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.elements import circle, grid
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry
from chachart.node.estimation import spectra
from chachart.node.estimation.bounds import information_scale
from chachart.node.estimation.directions.algebra import inverse
from chachart.node.estimation.directions.axis import manifold_of
from chachart.node.estimation.directions.manifold import compass
from chachart.node.estimation.directions.sphere import unit
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.subspace import dominant

CARRIER_HZ = 3.5e9
WAVE_M = SPEED_OF_LIGHT / CARRIER_HZ
SHAPES = {
    "2x4": grid(2, 4, WAVE_M / 2),
    "8x8": grid(8, 8, WAVE_M / 2),
    "uca5": circle(5, 0.33 * WAVE_M),
    "uca16": circle(16, WAVE_M),
    "space": np.random.default_rng(7).uniform(-WAVE_M, WAVE_M, (9, 3)),
}
BLOCK_SAMPLES = 1 << 20
METHODS = {
    "bartlett": lambda r, ends: np.linalg.cholesky(r),
    "mvdr": lambda r, ends: spectra.mvdr(r, 0.05),
    "music": lambda r, ends: dominant(r, 1).conj().swapaxes(1, 2),
    "minnorm": lambda r, ends: spectra.minnorm(dominant(r, 1).conj().swapaxes(1, 2), ends),
}


def an_array(shape: str, subcarriers: int = 16, **changes: Any) -> ArrayGeometry:
    return ArrayGeometry.of_elements("a", SHAPES[shape], subcarriers, CARRIER_HZ, 781250.0, **changes)


def somewhere(shape: str, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths and elevations that the array can tell, away from the edges."""
    if shape in ("2x4", "8x8"):
        return rng.uniform(-0.8, 0.8, count), rng.uniform(-0.6, 0.6, count)
    if shape == "space":
        return rng.uniform(-3.1, 3.1, count), rng.uniform(-1.0, 1.0, count)
    return rng.uniform(-3.1, 3.1, count), rng.uniform(-1.1, -0.5, count)


def some_frames(
    array: ArrayGeometry, d: np.ndarray, rho: np.ndarray, snr_db: float, rng: np.random.Generator
) -> np.ndarray:
    """One frame a UE: a plane wave from d (K, 3) at rho (K,), with a phase of its own, in noise."""
    steering = np.exp(2j * np.pi * array.middle_hz / array.light_speed_m_s * d @ array.own_elements.T)
    delay = np.exp(1j * array.rho_phase * rho[:, None] * array.tone_numbers)
    h = steering[:, :, None] * delay[:, None] * np.exp(2j * np.pi * rng.random((len(d), 1, 1)))
    noise = rng.standard_normal((*h.shape, 2), np.float32).view(np.complex64)[..., 0]
    return h.astype(np.complex64) + noise * np.float32(10 ** (-snr_db / 20) / np.sqrt(2))


def heard(
    array: ArrayGeometry, d: np.ndarray, rho: np.ndarray, snr_db: float, frames: int, rng: np.random.Generator
) -> Iterator[CsiBlock]:
    """All frames of so many UEs at a time, so that every UE is estimated once, from all of them."""
    at_once = max(1, BLOCK_SAMPLES // (array.antennas * array.subcarriers * frames))
    for start in range(0, len(d), at_once):
        ue = np.repeat(np.arange(start, min(start + at_once, len(d))), frames)
        yield CsiBlock.of(some_frames(array, d[ue], rho[ue], snr_db, rng), ue, np.arange(len(ue)))


def located(
    array: ArrayGeometry, shape: str, snr_db: float, ues: int = 500, frames: int = 10, **options: Any
):
    """Errors over the bound and over what is stated, in azimuth and elevation: root mean squares."""
    rng = np.random.default_rng(round(snr_db) + 100)
    azimuth, elevation = somewhere(shape, ues, rng)
    d, rho = unit(azimuth, elevation), rng.uniform(20, 300, ues)
    estimator = ChartEstimator(array, averaging="mean", **options)
    chart = ChartUpdate.concatenate([estimator.update(b) for b in heard(array, d, rho, snr_db, frames, rng)])
    manifold = manifold_of(array)
    scale = information(array, options["theta"], snr_db, frames)
    across, _, upwards = inverse(scale * manifold.information(d, np.stack(compass(d))))
    off = np.angle(np.exp(1j * (chart["azimuth"] - azimuth))), chart["elevation"] - elevation
    bound = np.sqrt(across) / np.cos(elevation), np.sqrt(upwards)
    stated = chart["azimuth_std"], chart["elevation_std"]
    theta_off = (chart.theta - np.arccos(d[:, 0])) / chart.theta_std
    rms = [
        float(np.sqrt(np.mean((e / b) ** 2))) for e, b in zip((*off, *off), (*bound, *stated), strict=True)
    ]
    return (*rms, float(np.sqrt(np.mean(theta_off**2))), chart)


def information(array: ArrayGeometry, method: str, snr_db: float, frames: int) -> Any:
    """Scale of the Fisher information; a joint method sees one snapshot a frame, of all tones together."""
    snr, tones = 10 ** (snr_db / 10), array.subcarriers
    if method == "joint":
        return information_scale(array.antennas, frames, snr * tones)
    return information_scale(array.antennas, frames * tones, snr)
