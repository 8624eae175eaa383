from __future__ import annotations

import numpy as np
import pytest
from csi_samples import assert_same_frames, some_block
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.data.counters import Counters
from chachart.sources.checks import usable

BAD = {"non_finite": [np.nan, np.inf, -np.inf, complex(0, np.nan)], "all_zero": [0.0]}


@given(
    st.lists(st.sampled_from(["good", "non_finite", "all_zero"]), min_size=1, max_size=20), st.integers(0, 3)
)
def test_bad_frames_go_and_their_neighbours_stay(kinds: list[str], variant: int) -> None:
    block = some_block(len(kinds))
    for row, kind in enumerate(kinds):
        if kind == "non_finite":
            block.csi[row, 2, 1] = BAD[kind][variant]
        elif kind == "all_zero":
            block.csi[row] = 0
    rejected = Counters()
    left = usable(block, rejected)
    good = np.array([kind == "good" for kind in kinds])
    if left is None:
        assert not good.any()
    else:
        assert_same_frames(left, block.take(good))
    assert rejected.as_dict() == {k: kinds.count(k) for k in ("non_finite", "all_zero") if k in kinds}


@pytest.mark.parametrize("value", [3e38, -3e38, 1e-45])
def test_extreme_but_finite_frames_are_good(value: float) -> None:
    block = some_block(3)
    block.csi[1] = value
    rejected = Counters()
    assert usable(block, rejected) is block
    assert rejected.total() == 0


def test_frames_that_sum_to_zero_are_good() -> None:
    block = some_block(2)
    block.csi[1] = 0
    block.csi[1, 0, :2] = [1, -1]
    rejected = Counters()
    assert usable(block, rejected) is block
