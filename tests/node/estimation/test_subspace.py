from __future__ import annotations

import numpy as np
import pytest

from chachart.node.estimation.subspace import SubspaceTracker, dominant

SIZE, SNAPSHOTS, UES = 32, 320, 400


def covariances(snr_db: float, seed: int) -> np.ndarray:
    """Of one path each, at its SNR per element, in white noise."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-np.pi, np.pi, (UES, 1))
    steering = np.exp(1j * u * np.arange(SIZE))
    noise = rng.standard_normal((2, UES, SIZE, SNAPSHOTS))
    x = 10 ** (snr_db / 20) * steering[:, :, None] + (noise[0] + 1j * noise[1]) / np.sqrt(2)
    return (x @ x.conj().swapaxes(1, 2)).astype(np.complex64)


@pytest.mark.parametrize("snr_db", [-20.0, -15.0, -10.0, 10.0])
def test_a_new_ue_gets_its_dominant_eigenvector_however_weak_its_path(snr_db: float) -> None:
    r = covariances(snr_db, 1)
    tracker = SubspaceTracker(SIZE, 1)
    tracker.resize(UES)
    basis = tracker.update(np.arange(UES), r, np.full(UES, float(SNAPSHOTS)))
    alike = np.abs(np.einsum("kon,kon->k", basis, dominant(r, 1).conj()))
    assert alike.min() > 0.98
    assert np.median(alike) > 0.9999


def test_a_tracked_ue_follows_its_path() -> None:
    tracker = SubspaceTracker(SIZE, 1)
    tracker.resize(UES)
    slots = np.arange(UES)
    for seed in range(3):  # each time quite another path
        r = covariances(-12.0, seed)
        basis = tracker.update(slots, r, np.full(UES, float(SNAPSHOTS)))
        alike = np.abs(np.einsum("kon,kon->k", basis, dominant(r, 1).conj()))
        assert alike.min() > 0.98
