"""Cutting a stream of blocks into blocks per shard. Pure: no sockets, no threads, the clock is passed in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

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


@dataclass(slots=True)
class _Pending:
    blocks: list[CsiBlock] = field(default_factory=list)
    frames: int = 0
    arrivals: list[tuple[float, int]] = field(default_factory=list)
    start: int = 0
    end: int = 0


def shard_of(ue: NDArray[np.uint64], shards: int) -> NDArray[np.intp]:
    """The shard that each UE belongs to for good: splitmix64 of its number, modulo `shards`."""
    z = ue + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return (z % np.uint64(shards)).astype(np.intp)


class Partitioner:
    """Blocks of any size in, blocks of at most `block_frames` frames of one shard out.

    Frames of one UE keep their order. A block leaves when it is full, or by `due` when its first frame has
    waited `linger_s`. With one shard, whole blocks pass through as views, without a copy.
    """

    def __init__(self, shards: int, block_frames: int, linger_s: float) -> None:
        self._shards = shards
        self._block_frames = block_frames
        self._linger = linger_s
        self._pending = [_Pending() for _ in range(shards)]

    def add(self, block: CsiBlock, now: float, numbers: NDArray[np.int64]) -> list[ShardBlock]:
        """Take a block that came in at `now`, with the reader's number of each frame; gives what is full."""
        if self._shards == 1:
            return list(self._extend(0, block, now, numbers))
        shard = shard_of(block.ue, self._shards)
        order = np.argsort(shard, kind="stable")
        ends = np.searchsorted(shard[order], np.arange(self._shards + 1))
        full: list[ShardBlock] = []
        for s in range(self._shards):
            if ends[s] < ends[s + 1]:
                index = order[ends[s] : ends[s + 1]]
                full += self._extend(s, block.take(index), now, numbers[index])
        return full

    def due(self, now: float) -> list[ShardBlock]:
        """The blocks whose first frame has waited long enough at `now`."""
        return [
            self._emit(s)
            for s, pending in enumerate(self._pending)
            if pending.frames and now >= pending.arrivals[0][0] + self._linger
        ]

    def deadline(self) -> float | None:
        """When `due` will next have something to give, or None if nothing waits."""
        arrivals = [p.arrivals[0][0] for p in self._pending if p.frames]
        return min(arrivals) + self._linger if arrivals else None

    def flush(self) -> list[ShardBlock]:
        """Everything that waits, now."""
        return [self._emit(s) for s, pending in enumerate(self._pending) if pending.frames]

    def waiting_from(self) -> int | None:
        """The lowest number of a frame that waits here, or None."""
        return min((p.start for p in self._pending if p.frames), default=None)

    def _extend(
        self, shard: int, block: CsiBlock, now: float, numbers: NDArray[np.int64]
    ) -> Iterator[ShardBlock]:
        start = 0
        while start < len(block):
            pending = self._pending[shard]
            if pending.frames and pending.blocks[-1].array != block.array:
                yield self._emit(shard)
                pending = self._pending[shard]
            stop = min(len(block), start + self._block_frames - pending.frames)
            if not pending.frames:
                pending.start = int(numbers[start])
            pending.end = int(numbers[stop - 1]) + 1
            pending.blocks.append(block.cut(start, stop))
            pending.arrivals.append((now, stop - start))
            pending.frames += stop - start
            start = stop
            if pending.frames == self._block_frames:
                yield self._emit(shard)

    def _emit(self, shard: int) -> ShardBlock:
        pending = self._pending[shard]
        self._pending[shard] = _Pending()
        block = CsiBlock.concatenate(pending.blocks)
        return ShardBlock(shard, block, tuple(pending.arrivals), pending.start, pending.end)
