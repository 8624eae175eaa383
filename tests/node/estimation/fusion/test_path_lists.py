"""Lists of paths: what is left of frames that are told by them, and what fusing them is worth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from misplaced_arrays import hall, heard
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.path_list import PathList
from chachart.node.estimation.calibrate import spherical
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.estimation.fusion.options import FusionOptions
from chachart.node.estimation.fusion.path_lists import PathLists
from chachart.sources.charts import Waves

BOARD = hall().right[0]
LINE = ArrayGeometry("line", 16, 32, 3.5e9, 50e6 / 32, 0.0428, position_m=(-12.0, -12.0, 4.0))
FUSION = FusionOptions(area_m=(-10.0, -10.0, 10.0, 10.0), height_m=1.2)


def _rows(csi: NDArray[np.complex64], array: ArrayGeometry, **options: Any) -> tuple[ChartUpdate, CsiBlock]:
    block = CsiBlock.of(csi, np.arange(len(csi)), 0, array=array.name)
    estimator = ChartEstimator(array, theta="joint", rho="joint", memory_frames=1, **options)
    return PathLists(array).told(estimator.update(block), block), block


@pytest.mark.parametrize("array", [BOARD, LINE], ids=lambda one: one.name)
def test_a_frame_of_few_paths_comes_back_from_its_list(array: ArrayGeometry) -> None:
    rng = np.random.default_rng(2)
    height = 4.0 if array.is_line else 1.0
    direct = np.column_stack([rng.uniform(-4, 8, (20, 2)), np.full(20, height)])
    echo = np.column_stack([rng.uniform(60, 70, 20), rng.uniform(-80, 90, 20), np.full(20, height)])
    csi = spherical(array, direct) * np.linalg.norm(direct - array.centre_m, axis=1)[:, None, None]
    csi += 0.7 * spherical(array, echo) * np.linalg.norm(echo - array.centre_m, axis=1)[:, None, None]
    csi = (0.01 * csi).astype(np.complex64)
    update, _ = _rows(csi, array)
    assert len(update) == 20
    again = Waves(array, ranges=True).frames(update)
    kept = np.abs(np.einsum("kns,kns->k", csi.conj(), again))
    kept /= np.linalg.norm(csi, axis=(1, 2)) * np.linalg.norm(again, axis=(1, 2))
    assert np.median(kept) > 0.99
    assert (kept > 0.95).all()
    np.testing.assert_allclose(
        np.linalg.norm(again, axis=(1, 2)), np.linalg.norm(csi, axis=(1, 2)), rtol=0.15
    )


def test_packed_lists_are_what_they_were() -> None:
    update, _ = _rows(spherical(BOARD, np.array([[1.0, 2.0, 1.2]])).astype(np.complex64), BOARD)
    paths = PathList.unpacked(update["paths"])
    np.testing.assert_allclose(paths.packed(), update["paths"], atol=1e-9)
    far = np.linalg.norm([1.0, 2.0, 1.2] - BOARD.centre_m)
    assert paths.length_m[0, 0] == pytest.approx(far, abs=0.05)
    assert np.abs(paths.amplitude[0, 0]) == pytest.approx(1.0, abs=0.05)
    assert paths.direction[0, 0] @ BOARD.frame == pytest.approx(
        ([1.0, 2.0, 1.2] - BOARD.centre_m) / far, abs=0.01
    )


def test_what_does_not_count_makes_no_difference() -> None:
    csi = spherical(BOARD, np.array([[1.0, 2.0, 1.2], [5.0, -3.0, 1.2]])).astype(np.complex64)
    broken = replace(BOARD, dead_antennas=(0,), dead_tones=(3, 4))
    noisy = csi.copy()
    noisy[:, 0] = noisy[:, :, 3:5] = 100.0
    update, _ = _rows(noisy, broken)
    again = Waves(BOARD, ranges=True).frames(update)
    kept = np.abs(np.einsum("kns,kns->k", csi.conj(), again))
    assert (kept / np.linalg.norm(csi, axis=(1, 2)) / np.linalg.norm(again, axis=(1, 2)) > 0.98).all()


def _error(arrays: tuple[ArrayGeometry, ...], frames: list[NDArray[np.complex64]], places: Any) -> float:
    estimator = FusedEstimator(arrays, FUSION)
    blocks = [
        CsiBlock.of(csi, np.arange(len(csi)), 0, array=array.name)
        for array, csi in zip(arrays, frames, strict=True)
    ]
    chart = estimator.update_all(blocks)
    assert len(chart) == len(places)
    return float(np.hypot(chart.x - places[:, 0], chart.y - places[:, 1]).mean())


def test_lists_of_paths_are_worth_nearly_what_frames_are() -> None:
    rng = np.random.default_rng(11)
    arrays = hall().right
    places = np.column_stack([rng.uniform(-8, 8, (160, 2)), np.full(160, 1.2)])
    frames = [heard(array, places, np.zeros(160), 0.15, rng) for array in arrays]
    listed = []
    for array, csi in zip(arrays, frames, strict=True):
        update, _ = _rows(csi, array)
        assert update.ue.tolist() == list(range(160))
        listed.append(Waves(array, ranges=True).frames(update))
    assert _error(arrays, listed, places) < 1.5 * _error(arrays, frames, places)
