"""What a UE is said to take is what it takes."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from chachart.node.commands.benchmarks.arrays import an_array
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import RhoMethod, ThetaMethod
from chachart.node.estimation.estimator import ChartEstimator

UES = 1024
ARRAYS = {
    "line": ArrayGeometry("lab", 16, 8, 3.5e9, 312_500.0, 0.04),
    "board": an_array("board 2 x 4", 8),
    "circle": an_array("circle of 5", 8),
}


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize(
    ("theta", "rho"),
    [
        ("bartlett", "bartlett"),
        ("mvdr", "mvdr"),
        ("music", "music"),
        ("joint", "joint"),
        ("bartlett", "isq"),
    ],
)
def test_it_is_what_the_process_grows_by(name: str, theta: ThetaMethod, rho: RhoMethod) -> None:
    array = ARRAYS[name]
    estimator = ChartEstimator(array, theta=theta, rho=rho, max_ues=UES)
    rng = np.random.default_rng(0)
    shape = (UES, array.antennas, array.subcarriers)
    csi = rng.standard_normal((*shape, 2), np.float32).view(np.complex64)[..., 0]

    def update(ues: slice) -> None:
        ue = np.arange(UES, dtype=np.uint64)[ues]
        estimator.update(CsiBlock(array.name, 0, ue, np.full(len(ue), 1), csi[ues]))

    update(slice(0, 64))  # tables that are made once
    tracemalloc.start()
    try:
        for start in range(64, UES, 64):
            update(slice(start, start + 64))
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert held == pytest.approx(UES * estimator.bytes_per_ue, rel=0.1, abs=80 * UES)
