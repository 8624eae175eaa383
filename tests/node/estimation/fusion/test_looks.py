"""What is said of single arrays and single UEs beside fused positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.estimation.fusion.options import TrackingOptions

from .test_estimator import AREA, PLACES, STEP_NS, _block, arrays

__all__ = ["arrays"]


def test_each_array_says_where_it_hears_a_ue_from(arrays: list[ArrayGeometry]) -> None:
    estimator = FusedEstimator(arrays, AREA)
    assert estimator.spectrum(1) is None
    for array in arrays:
        estimator.update(_block(array, PLACES, 0))
    found = estimator.spectrum(1)
    assert found is not None
    assert [one["name"] for one in found["arrays"]] == ["a", "b", "c"]
    for array, one in zip(arrays, found["arrays"], strict=True):
        x, y = PLACES[1] - array.centre_m[:2]
        assert one["bearing_rad"] == pytest.approx(np.arctan2(y, x), abs=0.03)
        far = float(np.hypot(np.hypot(x, y), 2.5))
        assert one["rho_grid_m"][int(np.argmax(one["rho_spectrum"]))] == pytest.approx(far, abs=1.0)
        assert one["share"] > 0.9
    loudest = max(range(3), key=lambda i: found["arrays"][i]["power_db"])
    theta, rho = arrays[loudest].theta_rho(np.array([*PLACES[1], 1.5]))
    assert (found["theta"], found["rho"]) == pytest.approx((theta, rho), abs=0.1)
    assert (np.diff(found["theta_grid_rad"]) >= 0).all()
    assert len(found["theta_grid_rad"]) == len(found["theta_spectrum"])
    estimator.options = estimator.options.model_copy(update={"forget_after_s": 1.0})
    estimator.forget(10**15)
    assert estimator.spectrum(1) is None


@pytest.mark.parametrize("motion", ["off", "walk"])
def test_shares_and_offsets_of_arrays_are_told(arrays: list[ArrayGeometry], motion: str) -> None:
    late_s = 12e-9
    estimator = FusedEstimator(arrays, AREA, TrackingOptions(motion=motion))
    for i in range(60):
        for array in arrays:
            if array.name == "c" and i % 2:
                continue
            block = _block(array, PLACES, i * STEP_NS)
            if array.name == "b":
                turn = np.exp(-2j * np.pi * array.offsets_hz * late_s).astype(np.complex64)
                block = replace(block, csi=block.csi * turn)
            estimator.update(block)
    report = {one["name"]: one for one in estimator.array_report()}
    shares = {name: one["heard"] / one["transmissions"] for name, one in report.items()}
    assert shares == pytest.approx({"a": 1.0, "b": 1.0, "c": 0.5}, abs=0.03)
    assert report["b"]["offset_ns"] - report["a"]["offset_ns"] == pytest.approx(12, abs=6)


def test_truth_is_in_the_world_where_positions_are_fused(arrays: list[ArrayGeometry]) -> None:
    line = ArrayGeometry("line", 8, 32, 3.5e9, 50e6 / 32, 0.04, position_m=(5.0, 5.0, 3.0))
    estimator = FusedEstimator(arrays, AREA)
    for array in arrays:
        update = estimator.update(_block(array, PLACES, 0))
    np.testing.assert_allclose(np.column_stack(update.truth_of(line)), PLACES, atol=1e-5)
