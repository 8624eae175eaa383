"""Cutting a stream of blocks into blocks per shard. Pure: no sockets, no threads, the clock is passed in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.csi import CsiBlock


@dataclass(frozen=True, slots=True, eq=False)
class ShardBlock:
    """A block for one shard.

    Attributes
    ----------
    shard, block
        Whose frames, and the frames.
    arrivals
        When they came in: (monotonic seconds, frames), first ones first.
    start, end
        The reader's number of the first frame, and one more than that of the last: all frames of the shard
        below `start` are in blocks before this one.
    """

    shard: int
    block: CsiBlock
    arrivals: tuple[tuple[float, int], ...]
    start: int
    end: int

    def fits(self, other: ShardBlock) -> bool:
        """Whether they may be joined."""
        return self.block.array == other.block.array

    @staticmethod
    def joined(blocks: Sequence[ShardBlock]) -> ShardBlock:
        """One block of all frames of blocks that follow each other."""
        first, last = blocks[0], blocks[-1]
        if len(blocks) == 1:
            return first
        arrivals = tuple(arrival for block in blocks for arrival in block.arrivals)
        block = CsiBlock.concatenate([block.block for block in blocks])
        return ShardBlock(first.shard, block, arrivals, first.start, last.end)


def shard_of(ue: NDArray[np.uint64], shards: int) -> NDArray[np.intp]:
    """The shard that each UE belongs to for good: splitmix64 of its number, modulo `shards`."""
    z = ue + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return (z % np.uint64(shards)).astype(np.intp)


class Partitioner:
    """Blocks of any size in, blocks of at most `block_frames` frames of one shard out.

    Frames of one UE keep their order. With one shard, blocks pass through as views, without a copy.
    """

    def __init__(self, shards: int, block_frames: int) -> None:
        self._shards = shards
        self._block_frames = block_frames

    def parts(self, block: CsiBlock, now: float, numbers: NDArray[np.int64]) -> Iterator[ShardBlock]:
        """The shards' parts of a block that came in at `now`, with the reader's number of each frame."""
        if self._shards == 1:
            yield from self._cut(0, block, now, numbers)
            return
        shard = shard_of(block.ue, self._shards)
        order = np.argsort(shard, kind="stable")
        ends = np.searchsorted(shard[order], np.arange(self._shards + 1))
        for s in range(self._shards):
            if ends[s] < ends[s + 1]:
                index = order[ends[s] : ends[s + 1]]
                yield from self._cut(s, block.take(index), now, numbers[index])

    def _cut(
        self, shard: int, block: CsiBlock, now: float, numbers: NDArray[np.int64]
    ) -> Iterator[ShardBlock]:
        for start in range(0, len(block), self._block_frames):
            stop = min(len(block), start + self._block_frames)
            part = block.cut(start, stop)
            first, last = int(numbers[start]), int(numbers[stop - 1])
            yield ShardBlock(shard, part, ((now, stop - start),), first, last + 1)
