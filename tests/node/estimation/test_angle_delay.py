from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.angle_delay import LOWEST_DB, angle_delay

ARRAY = ArrayGeometry("lab", 16, 32, 2e9, 312_500.0, 0.0749481145)


def paths(*given: tuple[float, float, float]) -> np.ndarray:
    """Four frames of paths (theta, rho, dB) with phases of their own, and a little noise."""
    rng = np.random.default_rng(0)
    n, s = np.arange(ARRAY.antennas)[:, None], np.arange(ARRAY.subcarriers)
    csi = np.zeros((4, ARRAY.antennas, ARRAY.subcarriers), complex)
    for theta, rho, level in given:
        wave = np.exp(1j * (ARRAY.theta_phase * np.cos(theta) * n + ARRAY.rho_phase * rho * s))
        csi += 10 ** (level / 20) * np.exp(2j * np.pi * rng.random((4, 1, 1))) * wave
    noise = rng.standard_normal((2, *csi.shape)) / 100
    return (csi + noise[0] + 1j * noise[1]).astype(np.complex64)


def test_paths_stand_out_where_they_are() -> None:
    found = angle_delay(paths((1.0, 200.0, 0.0), (2.0, 500.0, -8.0)), ARRAY)["paths"]
    assert len(found) == 2, "and no side lobe passes for one"
    off = np.abs(np.array(found) - [(1.0, 200.0, 0.0), (2.0, 500.0, -8.0)])
    assert (off < [(0.06, 10.0, 0.1), (0.06, 10.0, 1.5)]).all()


def test_the_picture_has_a_row_an_angle_and_a_column_a_range() -> None:
    picture = angle_delay(paths((1.0, 200.0, 0.0)), ARRAY)
    level = np.array(picture["db"])
    assert level.shape == (len(picture["angle_rad"]), len(picture["rho_m"]))
    assert (level.min(), level.max()) == (LOWEST_DB, 0)
    i, j = np.unravel_index(level.argmax(), level.shape)
    assert picture["angle_rad"][i] == pytest.approx(1.0, abs=0.05)
    assert picture["rho_m"][j] == pytest.approx(200.0, abs=10.0)


def test_dead_antennas_and_nothing_at_all() -> None:
    csi = paths((1.0, 200.0, 0.0))
    csi[:, 3] = np.nan
    assert len(angle_delay(csi, replace(ARRAY, dead_antennas=(3,)))["paths"]) == 1
    assert angle_delay(np.zeros_like(csi), ARRAY)["paths"] == []
