"""Strongest paths of single frames against theory: errors are as large as the Cramér-Rao bound says."""

from __future__ import annotations

import numpy as np
import pytest
from misplaced_arrays import hall
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.calibrate import spherical
from chachart.node.estimation.fusion.strongest import Pathfinder

BOARD = hall().right[0]
LINE = ArrayGeometry("line", 8, 32, 3.5e9, 50e6 / 32, 0.0428, position_m=(-12.0, -12.0, 3.0))
SNR = 10.0


def _bound(array: ArrayGeometry, place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cramér-Rao bound (3, 3) of a UE's world position from one frame of unknown amplitude and phase."""
    step = 1e-5
    moves = np.vstack([np.zeros(3), step * np.eye(3)])
    wave = spherical(array, place + moves).reshape(4, -1)
    slopes = (wave[1:] - wave[0]) / step
    slopes -= np.outer(slopes @ wave[0].conj(), wave[0]) / np.vdot(wave[0], wave[0]).real
    power = np.vdot(wave[0], wave[0]).real / wave.shape[1]
    return np.asarray(np.linalg.pinv(2 * SNR / power * (slopes.conj() @ slopes.T).real, rcond=1e-6))


@pytest.mark.parametrize("array", [BOARD, LINE], ids=lambda one: one.name)
def test_errors_are_those_of_the_bound_and_are_told(array: ArrayGeometry) -> None:
    rng = np.random.default_rng(4)
    count = 200
    place = np.array([4.0, 1.0, 3.0 if array.is_line else 1.2])
    wave = spherical(array, np.tile(place, (count, 1)))
    wave /= np.abs(wave).mean()
    noise = rng.standard_normal((*wave.shape, 2)).view(np.complex128)[..., 0]
    csi = (wave + noise * np.sqrt(0.5 / SNR)).astype(np.complex64)
    away = place - array.centre_m
    far = float(np.linalg.norm(away))
    paths = Pathfinder(array)(csi, np.full(count, 1.1 * far))
    unit = array.frame @ away / far
    angle = np.einsum("kax,x->ka", paths.across, unit)
    length = paths.length_m - far
    told_angle = np.einsum("ka,kab,kb->k", angle, np.linalg.inv(paths.angle_cov), angle).mean()
    assert told_angle / angle.shape[1] == pytest.approx(1.0, abs=0.3)
    assert np.mean(length**2 / paths.length_var) == pytest.approx(1.0, abs=0.3)
    bound = array.frame @ _bound(array, place) @ array.frame.T
    along = unit @ bound @ unit
    assert np.mean(length**2) == pytest.approx(along, rel=0.3)
    sideways = np.einsum("ax,xy,ay->a", paths.across[0], bound, paths.across[0]).sum() / far**2
    assert np.mean((angle**2).sum(axis=1)) == pytest.approx(sideways, rel=0.3)
    assert (paths.share > 0.8).all()
