"""Angle-delay profiles: short vectors whose distances say how unlike two UEs' channels are.

A frame's profile is its angle-delay amplitude spectrum, which knows no phase and little of path loss, each
array's scaled to energy 1. UEs side by side share most of their paths, whether or not a direct one is among
them, so that near profiles mean near places (angle-delay dissimilarities: Stephan, Euchner and ten Brink,
"Angle-delay profile-based and timestamp-aided dissimilarity metrics for channel charting", IEEE Trans.
Commun. 2024). What is kept is a random projection of it, which keeps distances to a few percent (Johnson and
Lindenstrauss 1984).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from chachart.node.estimation.fusion.fuser import Clock
from chachart.node.estimation.fusion.site import Complex, Floats, Site, phasor

Profiles = NDArray[np.float32]

LENGTH = 128
"""Numbers that a profile is projected to: distances keep to 6 %."""
OVERSAMPLING = 1.5
"""Beams and delays for each resolution cell."""
MOST_BEAMS, MOST_DELAYS = 256, 128
"""Larger spectra are sampled more coarsely in angle, and averaged over neighbouring delays."""
FLAT = 0.6
"""Squared mean of an amplitude spectrum by its mean square; noise has pi / 4, and says nothing."""
_CHUNK_BYTES = 1 << 24


class Profiler:
    """Makes profiles of the frames of one or several arrays.

    Parameters
    ----------
    sites
        The arrays.
    clock
        `shared`: delays are distances. `offset`: delays of all arrays may be shifted alike from frame to
        frame; each frame's are counted from their mean. `own`: those of every array may be; so are their own.
    """

    def __init__(self, sites: Sequence[Site], clock: Clock = "shared") -> None:
        self._pictures = [_Picture(site, number) for number, site in enumerate(sites)]
        self._clock = clock

    def of(self, frames: Sequence[Complex]) -> Profiles:
        """Profiles (K, LENGTH) of one complex64 (K, N, S) an array, zeros where it has heard nothing."""
        if self._clock != "shared":
            frames = _from_mean_delay(frames, self._clock == "offset")
        total = np.zeros((len(frames[0]), LENGTH), np.float32)
        for picture, csi in zip(self._pictures, frames, strict=True):
            total += picture.projected(csi)
        return total


class _Picture:
    """One array's share in the profiles."""

    def __init__(self, site: Site, number: int) -> None:
        self._beams = beams(site)
        tones = len(site.tones_hz)
        self._window = np.hanning(tones + 2)[1:-1].astype(np.float32)
        self._pool = int(np.ceil(OVERSAMPLING * tones / MOST_DELAYS))
        self._bins = int(np.ceil(OVERSAMPLING * tones / self._pool)) * self._pool
        rng = np.random.default_rng(number)
        size = len(self._beams) * (self._bins // self._pool)
        self._projection = rng.standard_normal((size, LENGTH), np.float32) / np.float32(np.sqrt(LENGTH))

    def projected(self, csi: Complex) -> Profiles:
        """(K, LENGTH) of frames (K, N, S)."""
        found = np.empty((len(csi), LENGTH), np.float32)
        step = max(_CHUNK_BYTES // (8 * len(self._beams) * self._bins), 1)
        for i in range(0, len(csi), step):
            amplitude = self._amplitude(csi[i : i + step]).reshape(-1, self._projection.shape[0])
            energy = np.einsum("kf,kf->k", amplitude, amplitude)
            heard = np.square(amplitude.mean(axis=1)) * amplitude.shape[1] < FLAT * energy
            amplitude *= np.where(heard, 1 / np.sqrt(np.maximum(energy, 1e-30)), 0)[:, None]
            np.matmul(amplitude, self._projection, out=found[i : i + step])
        return found

    def _amplitude(self, csi: Complex) -> NDArray[np.float32]:
        z = fft.ifft(np.matmul(self._beams, csi * self._window), self._bins, axis=2, norm="forward")
        power = z.real**2 + z.imag**2
        if self._pool > 1:
            power = power.reshape(*power.shape[:2], -1, self._pool).mean(axis=3)
        return np.sqrt(power)


def _from_mean_delay(frames: Sequence[Complex], together: bool) -> list[Complex]:
    """Frames whose power-weighted mean delay round the circle of unambiguous ones is 0."""
    turns = [np.einsum("kns,kns->k", csi[:, :, 1:], csi[:, :, :-1].conj()) for csi in frames]
    if together:
        turns = [np.sum(turns, axis=0)] * len(frames)
    back = [
        np.exp(-1j * np.angle(turn)[:, None] * np.arange(csi.shape[2]))
        for turn, csi in zip(turns, frames, strict=True)
    ]
    return [(csi * turn[:, None]).astype(np.complex64) for csi, turn in zip(frames, back, strict=True)]


def beams(site: Site) -> Complex:
    """Conjugate steering vectors (D, N) of directions all round, as dense as the aperture needs."""
    around = (site.elements - site.centre) / site.wavelength_m
    _, _, axes = np.linalg.svd(around, full_matrices=True)
    places = around @ axes.T
    aperture: Floats = np.ptp(places, axis=0)
    over = OVERSAMPLING
    while True:
        directions = _directions(aperture, over)
        if len(directions) <= MOST_BEAMS:
            return phasor(-(directions @ places.T))
        over *= 0.9


def _directions(aperture: Floats, over: float) -> Floats:
    """Projections (D, 3) of directions on the axes of an array; those without aperture are left at 0."""
    wide = aperture > 1e-3
    steps = [1 / (over * (a + 0.5)) for a in aperture]
    axes = [np.arange(-1, 1 + s / 2, s) if w else np.zeros(1) for s, w in zip(steps, wide, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    size = np.linalg.norm(points, axis=1)
    near = np.abs(size - 1) <= max(steps) / 2 if wide.all() else size <= 1 + 1e-9
    found: Floats = points[near] / (size[near, None] if wide.all() else 1)
    return found
