from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from chachart.node.data.csi import CsiBlock
from chachart.node.runtime.partition import Partitioner, ShardBlock, shard_of

Sizes = st.lists(st.integers(1, 70), min_size=1, max_size=12)


def make_blocks(sizes: list[int], ues: int = 20) -> list[CsiBlock]:
    """Frames that carry their own number as time and sample."""
    rng = np.random.default_rng(len(sizes))
    blocks, seq = [], 0
    for size in sizes:
        number = np.arange(seq, seq + size)
        csi = number.astype(np.complex64)[:, None, None] * np.ones((1, 2, 2), np.complex64)
        ue = rng.integers(0, ues, size).astype(np.uint64)
        blocks.append(CsiBlock("lab", seq, ue, number, csi))
        seq += size
    return blocks


def numbers(block: CsiBlock) -> NDArray[np.int64]:
    return np.arange(block.seq, block.seq + len(block))


def run(partitioner: Partitioner, blocks: list[CsiBlock]) -> list[ShardBlock]:
    return [
        out
        for now, block in enumerate(blocks)
        for out in partitioner.parts(block, float(now), numbers(block))
    ]


@given(sizes=Sizes, shards=st.integers(1, 5), block_frames=st.integers(1, 40))
def test_every_frame_leaves_once_in_the_order_of_its_ue(
    sizes: list[int], shards: int, block_frames: int
) -> None:
    blocks = make_blocks(sizes)
    blocks_out = run(Partitioner(shards, block_frames), blocks)
    everything = CsiBlock.concatenate(blocks)
    assert sorted(n for p in blocks_out for n in p.block.time_ns.tolist()) == everything.time_ns.tolist()
    for out in blocks_out:
        assert len(out.block) <= block_frames
        assert (shard_of(out.block.ue, shards) == out.shard).all()
        np.testing.assert_array_equal(out.block.csi[:, 0, 0].real, out.block.time_ns)
    for ue in np.unique(everything.ue):
        times = [t for p in blocks_out for t in p.block.time_ns[p.block.ue == ue].tolist()]
        assert times == sorted(times)


def test_one_shard_passes_blocks_through_without_a_copy() -> None:
    [block] = make_blocks([128])
    blocks_out = list(Partitioner(1, 64).parts(block, 0.0, numbers(block)))
    assert [len(p.block) for p in blocks_out] == [64, 64]
    assert all(np.shares_memory(p.block.csi, block.csi) for p in blocks_out)
    assert [p.block.seq for p in blocks_out] == [0, 64]


def test_parts_that_follow_each_other_are_joined() -> None:
    partitioner = Partitioner(1, 64)
    first, second = (
        next(partitioner.parts(block, now, numbers(block)))
        for block, now in zip(make_blocks([10, 5]), (1.0, 1.004), strict=True)
    )
    joined = ShardBlock.joined([first, second])
    assert (len(joined.block), joined.start, joined.end) == (15, 0, 15)
    assert joined.arrivals == ((1.0, 10), (1.004, 5))
    assert ShardBlock.joined([first]) is first


def test_shards_are_stable_and_even() -> None:
    ue = np.arange(100_000, dtype=np.uint64)
    shard = shard_of(ue, 4)
    np.testing.assert_array_equal(shard, shard_of(ue, 4))
    counts = np.bincount(shard, minlength=4)
    assert abs(counts / len(ue) - 0.25).max() < 0.01
    assert set(shard_of(np.array([0, 2**64 - 1], np.uint64), 1)) == {0}
