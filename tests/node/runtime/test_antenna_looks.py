from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.runtime.antenna_looks import LOOK_EVERY_S, AntennaLooks

ARRAY = ArrayGeometry("lab", 8, 6, 2e9, 1e6, 0.075)


def waves(seed: int, dead: int | None, noise: float = 0.03) -> CsiBlock:
    """Sixteen UEs at angles of 40 to 140 degrees and 100 m; the dead antenna has noise alone."""
    rng = np.random.default_rng(seed)
    theta = np.linspace(0.7, 2.4, 16)[:, None, None]
    n, s = np.arange(8)[:, None], np.arange(6)
    csi = np.exp(1j * (ARRAY.theta_phase * np.cos(theta) * n + ARRAY.rho_phase * 100.0 * s))
    if dead is not None:
        csi[:, dead] = 0
    size = np.full((8, 1), noise)
    if dead is not None:
        size[dead] = 0.2
    csi = csi + size * (rng.standard_normal(csi.shape) + 1j * rng.standard_normal(csi.shape))
    return CsiBlock.of(csi, ue=np.arange(16), time_ns=seed, array="lab")


def seen(looks: AntennaLooks, blocks: int, dead: int | None, first: int = 0) -> None:
    for n in range(first, first + blocks):
        looks.see(waves(n, dead), n * 2 * LOOK_EVERY_S)


def test_a_dead_antenna_is_left_out_and_comes_back() -> None:
    looks = AntennaLooks(ARRAY)
    block = waves(0, 3)
    assert looks.without_dead(block) is block
    seen(looks, 60, 3)
    assert list(looks.report()["dead_s"]) == ["3"]
    left = looks.without_dead(block)
    assert not left.csi[:, 3].any()
    np.testing.assert_array_equal(np.delete(left.csi, 3, 1), np.delete(block.csi, 3, 1))
    assert block.csi[:, 3].all(), "who else has the block keeps it as it came"
    seen(looks, 600, None, first=60)
    assert "dead_s" not in looks.report()
    assert looks.without_dead(block) is block


@pytest.mark.parametrize("methods", [("bartlett", "bartlett"), ("music", "music"), ("joint", "joint")])
def test_weight_0_turns_no_direction_and_moves_no_range(methods: tuple[str, str]) -> None:
    looks = AntennaLooks(ARRAY)
    seen(looks, 60, 3)
    options = {"theta": methods[0], "rho": methods[1], "averaging": "mean"}
    by_detection = ChartEstimator(ARRAY, **options)
    by_mask = ChartEstimator(replace(ARRAY, dead_antennas=(3,)), **options)
    for n in range(4):
        block = looks.without_dead(waves(n, 3))
        assert not block.csi[:, 3].any()
        rows, masked = by_detection.update(block), by_mask.update(block)
    np.testing.assert_allclose(rows.theta, masked.theta, atol=1e-3)
    np.testing.assert_allclose(rows.rho, masked.rho, atol=0.1)
    np.testing.assert_allclose(rows.theta, np.linspace(0.7, 2.4, 16), atol=0.01)
    np.testing.assert_allclose(rows.rho, 100.0, atol=1.5)
