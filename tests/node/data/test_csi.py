from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from csi_samples import assert_same_frames, some_block
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.data.csi import CsiBlock


def test_sizes() -> None:
    block = some_block(5, antennas=4, subcarriers=3)
    assert (len(block), block.antennas, block.subcarriers) == (5, 4, 3)


def test_it_says_what_it_is_in_a_line() -> None:
    block = some_block(5, antennas=4, subcarriers=3)
    ues = len(np.unique(block.ue))
    known = "" if block.position is None else ", position"
    expected = f"<CsiBlock of 'lab' from {block.seq}: 5 frames of {ues} UEs, 4 x 3{known}>"
    assert repr(block) == expected


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"ue": np.zeros(5, np.int64)}, "ue must be uint64"),
        ({"time_ns": np.zeros(5, np.uint64)}, "time_ns must be int64"),
        ({"time_ns": np.zeros(4, np.int64)}, r"time_ns must be int64 \(5,\)"),
        ({"csi": np.zeros((5, 4, 3), np.complex128)}, "csi must be complex64"),
        ({"csi": np.zeros((4, 4, 3), np.complex64)}, r"csi must be complex64 \(5, 4, 3\)"),
        ({"csi": np.zeros((5, 4), np.complex64)}, "csi must be"),
        ({"position": np.zeros((5, 2), np.float32)}, "position must be float32"),
        (
            {
                "ue": np.zeros(0, np.uint64), "time_ns": np.zeros(0, np.int64),
                "csi": np.zeros((0, 4, 3), np.complex64), "position": None,
            },
            "frames >= 1",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        replace(some_block(5), **changes)


@given(st.lists(st.integers(1, 6), min_size=1, max_size=5), st.booleans())
def test_concatenated_blocks_can_be_taken_apart(sizes: list[int], position: bool) -> None:
    blocks = [some_block(n, seq=i, position=position) for i, n in enumerate(sizes)]
    whole = CsiBlock.concatenate(blocks)
    assert (len(whole), whole.seq) == (sum(sizes), 0)
    ends = np.cumsum(sizes)
    for block, end in zip(blocks, ends, strict=True):
        assert_same_frames(whole.take(np.arange(end - len(block), end)), block)


def test_unknown_positions_among_known_ones_are_nan() -> None:
    whole = CsiBlock.concatenate([some_block(2, position=False), some_block(3)])
    assert whole.position is not None
    assert np.isnan(whole.position[:2]).all()
    assert np.isfinite(whole.position[2:]).all()


def test_a_mask_takes_frames() -> None:
    block = some_block(4)
    taken = block.take(np.array([True, False, False, True]))
    assert_same_frames(taken, block.take(np.array([0, 3])))
    assert len(taken) == 2


@given(st.integers(1, 6), st.integers(0, 5), st.integers(1, 7))
def test_cut(frames: int, start: int, count: int) -> None:
    block = some_block(frames, seq=100)
    start = min(start, frames - 1)
    cut = block.cut(start, start + count)
    assert cut.seq == 100 + start
    assert np.shares_memory(cut.csi, block.csi)
    assert_same_frames(cut, block.take(np.arange(start, min(start + count, frames))))


def test_a_block_of_plain_arrays() -> None:
    frames = np.arange(24).reshape(2, 4, 3)
    block = CsiBlock.of(frames, [7, 2**64 - 1], 5, [1, 2, 3], array="lab", seq=9)
    assert block.ue.tolist() == [7, 2**64 - 1]
    assert block.time_ns.tolist() == [5, 5]
    assert np.array_equal(block.csi, frames)
    assert np.array_equal(block.position, [[1, 2, 3], [1, 2, 3]])
    assert (block.array, block.seq) == ("lab", 9)


def test_one_plain_frame_is_of_now() -> None:
    before = time.time_ns()
    block = CsiBlock.of(np.ones((4, 3)), 1)
    assert block.csi.shape == (1, 4, 3)
    assert before <= block.time_ns[0] <= time.time_ns()
    assert block.position is None


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"csi": np.zeros(5)}, "csi must be"),
        ({"csi": np.array([[["a"]]])}, "csi must be"),
        ({"ue": [1, 2, 3]}, r"ue must be \(2,\), not \(3,\)"),
        ({"ue": [1.0, 2.0]}, "ue must be whole numbers"),
        ({"ue": [-1, 2]}, "ue must be uint64, not -1 to 2"),
        ({"time_ns": [2**63, 1]}, "time_ns must be int64"),
        ({"position": [[1, 2], [3, 4]]}, "position must be"),
    ],
)
def test_plain_arrays_that_do_not_go_together(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        CsiBlock.of(**{"csi": np.ones((2, 4, 3)), "ue": [1, 2], **changes})
