"""The same frames make the same chart, whatever blocks they come in."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.estimation import covariance
from chachart.node.estimation.covariance import Bank, Grouping, Weights
from chachart.node.estimation.estimator import ChartEstimator

Build = Callable[..., Any]

UES = 6
ROUNDING = 1e-6
"""What a column may differ by; ten times as much where the largest order of a block's UEs is worked with."""
CONVERGED = {"theta": 1e-4, "rho": 1e-3, "x": 1e-3, "y": 1e-3, "snr": 1e-3, "p_direct": 1e-2}
"""And where subspaces are tracked: they go on from the last block's, and stop where sampling is far worse."""

EXACT: list[dict[str, Any]] = [
    {"theta": "bartlett", "rho": "bartlett"},
    {"theta": "mvdr", "rho": "mvdr"},
    {"theta": "mvdr", "rho": "bartlett", "smoothing": 0.7},
    {"theta": "joint", "rho": "joint", "phase": "auto"},
    {"theta": "joint", "rho": "joint", "phase": "steady"},
    {"theta": "joint", "rho": "joint", "phase": "random"},
    *(
        {"rho": rho, "amplitude": amplitude}
        for rho in ("isq", "lr")
        for amplitude in ("debiased", "coherent", "noisy")
    ),
]
DECOMPOSED: list[dict[str, Any]] = [
    {"theta": "music", "rho": "music", "signal_order": "mdl"},
    {"theta": "minnorm", "rho": "music", "signal_order": "threshold"},
]
TRACKED: list[dict[str, Any]] = [
    {"theta": "music", "rho": "music"},
    {"theta": "minnorm", "rho": "minnorm"},
    {"theta": "music", "rho": "mvdr"},
]


def name(options: dict[str, Any]) -> str:
    return "-".join(map(str, options.values()))


def charted(estimator: ChartEstimator, frames: CsiBlock, size: int) -> ChartUpdate:
    """The last row of each UE, after `frames` in blocks of `size`."""
    pieces = [np.arange(i, min(i + size, len(frames))) for i in range(0, len(frames), size)]
    rows = ChartUpdate.concatenate([estimator.update(frames.take(piece)) for piece in pieces])
    last = {int(ue): i for i, ue in enumerate(rows.ue)}
    return rows.take(np.array([last[ue] for ue in sorted(last)]))


def in_blocks(world: Any, options: dict[str, Any], snr_db: float) -> list[ChartUpdate]:
    rng = np.random.default_rng(4)
    which = np.concatenate([rng.integers(0, UES, 60), np.zeros(12, np.intp), rng.permutation(UES)])
    training = world.block(snr_db, np.arange(UES), phase=False)
    frames = world.block(snr_db, which, phase=False)
    frames.position[:] = np.nan  # what LR and ISQ learn from positions, they learn row by row
    charts = []
    for size in (1, 7, len(frames)):
        estimator = ChartEstimator(world.array, **options)
        estimator.update(training)
        charts.append(charted(estimator, frames, size))
    return charts


@pytest.mark.parametrize("snr_db", [0.0, 60.0])
@pytest.mark.parametrize("averaging", ["mean", "exponential"])
@pytest.mark.parametrize("options", EXACT + DECOMPOSED, ids=name)
def test_charts_are_the_same_in_any_blocks(
    los: Build, options: dict[str, Any], averaging: str, snr_db: float
) -> None:
    world = los(UES, subcarrier_spacing_hz=312.5e3)
    one, *others = in_blocks(world, options | {"averaging": averaging}, snr_db)
    for chart in others:
        assert np.array_equal(chart.ue, one.ue)
        assert set(chart.columns) == set(one.columns)
        for column, values in one.columns.items():
            rounding = ROUNDING if options in EXACT else 10 * ROUNDING
            np.testing.assert_allclose(chart.columns[column], values, rtol=rounding, err_msg=column)


@pytest.mark.parametrize("averaging", ["mean", "exponential"])
@pytest.mark.parametrize("options", TRACKED, ids=name)
def test_charts_of_tracked_subspaces_are_as_good_in_any_blocks(
    los: Build, options: dict[str, Any], averaging: str
) -> None:
    world = los(UES, subcarrier_spacing_hz=312.5e3)
    one, *others = in_blocks(world, options | {"averaging": averaging}, 10.0)
    for chart in others:
        assert np.array_equal(chart.ue, one.ue)
        for column, tolerance in CONVERGED.items():
            np.testing.assert_allclose(
                chart.columns[column], one.columns[column], rtol=tolerance, err_msg=column
            )
        for column in ("theta", "rho"):
            off = np.abs(chart.columns[column] - one.columns[column])
            assert (off < 0.05 * one.columns[f"{column}_std"]).all(), column


@settings(max_examples=60, deadline=None)
@given(
    slots=st.lists(st.integers(0, 4), min_size=1, max_size=40),
    cuts=st.sets(st.integers(1, 39)),
    decay=st.sampled_from([1.0, 0.9, 0.25, 0.0]),
    most=st.sampled_from([2.0**20, 8.0]),
    seed=st.integers(0, 2**16),
)
def test_sums_are_the_same_to_the_bit(
    slots: list[int], cuts: set[int], decay: float, most: float, seed: int
) -> None:
    frames = np.random.default_rng(seed).standard_normal((len(slots), 3, 2), np.float32)
    x = np.ascontiguousarray(frames).view(np.complex64)[..., 0]
    found = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(covariance, "MOST_WEIGHT", most)
        for bounds in (sorted(cut for cut in cuts if cut < len(slots)), []):
            bank, weights = Bank((3,), np.complex64, decay), Weights(decay)
            for state in (bank, weights):
                state.resize(5)
            for part in np.split(np.arange(len(slots)), bounds):
                group = Grouping(np.array(slots)[part])
                told = weights.add(group)
                assert np.array_equal(bank.add(group, x[part]), bank.rows[group.slots])
                assert np.array_equal(told[0], weights.of(group.slots)[0])
            found.append((bank.rows, *weights.of(np.arange(5))))
    (rows, weight, effective), (other, other_weight, other_effective) = found
    assert np.array_equal(rows, other)
    assert weight == pytest.approx(other_weight, rel=1e-12)
    assert effective == pytest.approx(other_effective, rel=1e-12)
