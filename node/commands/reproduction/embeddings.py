"""Charts without a model of the array, for comparison: dimensionality reduction of covariance features.

As the channel-charting literature has it (Studer, Medjkouh, Gönültaş, Goldstein and Tirkkonen, "Channel
charting: locating users within the radio environment using channel state information", IEEE Access 2018):
raw second moments, scaled against path loss, absolute values in beamspace; then principal components or
Sammon's mapping.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import svds
from scipy.spatial.distance import cdist

Floats = NDArray[np.float64]
Real = NDArray[np.floating[Any]]

PATH_LOSS_SIGMA = 16.0
MOST_STEPS = 150
LEAST_GAIN = 2e-5
_CHUNK_UES = 64


def features(csi: NDArray[np.complex64]) -> NDArray[np.float32]:
    """|F R Fᴴ| / tr(R)^beta as vectors (U, N_R^2), of frames (U, frames, N_R, N_S).

    R is the sample covariance over the antennas, F the Fourier matrix (beamspace), and
    beta = 1 + 1 / (2 sigma): nearly all of the path loss is taken off, but the far stay apart from the near.
    """
    u, frames, antennas, subcarriers = csi.shape
    out = np.empty((u, antennas * antennas), np.float32)
    beta = 1 + 1 / (2 * PATH_LOSS_SIGMA)
    for i in range(0, u, _CHUNK_UES):
        x = csi[i : i + _CHUNK_UES].swapaxes(1, 2).reshape(-1, antennas, frames * subcarriers)
        beams = fft.fft(x, axis=1, norm="ortho")
        r = np.abs(np.matmul(beams, beams.conj().swapaxes(1, 2))) / np.float32(frames * subcarriers)
        r /= np.trace(r, axis1=1, axis2=2)[:, None, None] ** beta
        out[i : i + _CHUNK_UES] = r.reshape(len(r), -1)
    return out


def principal_components(x: Real) -> Floats:
    """The two largest principal components (U, 2) of features (U, D)."""
    centred = x - x.mean(axis=0)
    start = np.ones(min(centred.shape), centred.dtype)
    left, singular, _ = svds(centred, k=2, v0=start)
    components: Floats = (left * singular).astype(np.float64)
    return components


def sammon(x: Real, start: Real) -> Floats:
    """Sammon's mapping (1969) of features (U, D), from `start` (U, 2).

    Minimises sum (d - e)^2 / d over the pairs' distances d among features and e in the chart by majorisation
    (de Leeuw 1977): with weights 1 / d, V Z_next = B(Z) Z has one factorisation of V for all steps. Relaxed
    steps, 2 Z_next - Z, about halve their number. Coinciding features count as 1e-6 of the largest distance.
    """
    d = cdist(x, x).astype(np.float32)
    np.maximum(d, 1e-6 * d.max(), out=d)
    weight = 1 / d
    np.fill_diagonal(weight, 0)
    laplacian = -weight
    np.fill_diagonal(laplacian, weight.sum(axis=1))
    laplacian += weight.mean()  # its null space, a shift of all points, is of no interest
    factor = cho_factor(laplacian, lower=True, overwrite_a=True)
    z = start.astype(np.float32)
    before = np.inf
    for _ in range(MOST_STEPS):
        e = np.sqrt(np.maximum(cdist(z, z, "sqeuclidean"), 1e-24)).astype(np.float32)
        stress = float(np.vdot(weight, np.square(d - e)))
        if before - stress < LEAST_GAIN * stress:
            break
        before = stress
        np.divide(1, e, out=e)
        np.fill_diagonal(e, 0)
        z = 2 * cho_solve(factor, e.sum(axis=1)[:, None] * z - e @ z) - z
    return z.astype(np.float64)


def aligned(chart: Floats, truth: Floats) -> Floats:
    """The chart (U, 2) turned or mirrored onto the truth and spread as wide, for display."""
    a, b = truth - truth.mean(axis=0), chart - chart.mean(axis=0)
    left, _, right = np.linalg.svd(b.T @ a)
    onto: Floats = b @ left @ right * np.sqrt(np.vdot(a, a) / np.vdot(b, b)) + truth.mean(axis=0)
    return onto
