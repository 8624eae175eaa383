"""What waits for one worker and what it holds unacknowledged. Pure: no sockets, no threads.

Both promises of the node are kept here. A *live* shard drops its oldest waiting block when the queue is full
and counts what a dead worker held; a *lossless* one is full until a block is taken, and hands a dead worker's
blocks to its successor. At any time: frames put = estimated + dropped + held.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from chachart.node.data.counters import Counters
from chachart.node.runtime.partition import ShardBlock

MAX_DEATHS = 3
"""A block whose worker died so often while it was first in line is dropped, not sent again."""


@dataclass(slots=True, eq=False)
class Entry:
    """A block on its way.

    `seq` numbers the blocks of a shard in the order they were first sent, `method` (theta, rho) is what they
    were first sent to be estimated with: it stays with the block, however often that is sent.
    """

    content: ShardBlock
    seq: int = -1
    method: tuple[str, str] | None = None
    deaths: int = 0


class ShardQueue:
    """The way of blocks to one worker.

    Parameters
    ----------
    capacity
        Blocks that may wait.
    credit
        Blocks that the worker may hold unacknowledged.
    lossless
        Whether to keep every block.
    """

    def __init__(self, capacity: int, credit: int, lossless: bool) -> None:
        self._capacity = capacity
        self._credit = credit
        self._lossless = lossless
        self._waiting: deque[Entry] = deque()
        self._unacknowledged: dict[int, Entry] = {}
        self._next_seq = 0
        self.frames_held = 0
        self.frames_estimated = 0
        self.frames_replayed = 0
        self.dropped = Counters()

    @property
    def full(self) -> bool:
        """Whether a lossless source must wait before the next `put`."""
        return len(self._waiting) >= self._capacity

    @property
    def blocks_held(self) -> int:
        """Blocks that wait or are unacknowledged."""
        return len(self._waiting) + len(self._unacknowledged)

    def put(self, content: ShardBlock) -> None:
        """Add a block; a live queue that is full drops its oldest and counts it as `queue_full`."""
        if self.full and not self._lossless:
            self._drop(self._waiting.popleft(), "queue_full")
        self._waiting.append(Entry(content))
        self.frames_held += len(content.block)

    def next_to_send(self, method: tuple[str, str]) -> Entry | None:
        """The next block for the worker, from now on unacknowledged; None without block or credit."""
        if not self._waiting or len(self._unacknowledged) >= self._credit:
            return None
        entry = self._waiting.popleft()
        if entry.seq < 0:
            entry.seq = self._next_seq
            self._next_seq += 1
            entry.method = method
        self._unacknowledged[entry.seq] = entry
        return entry

    def acknowledge(
        self, seqs: Sequence[int], estimated: int, dropped: Mapping[str, int]
    ) -> list[ShardBlock]:
        """The worker is done with the blocks `seqs`; nothing happens if one is not (or no longer) its own."""
        if any(seq not in self._unacknowledged for seq in seqs):
            return []
        contents = [self._unacknowledged.pop(seq).content for seq in seqs]
        self.frames_held -= sum(len(content.block) for content in contents)
        self.frames_estimated += estimated
        self.dropped.merge(dropped)
        return contents

    def worker_lost(self) -> int:
        """The worker is dead: gives how many frames wait for its successor (0 for a live queue)."""
        held = list(self._unacknowledged.values())
        self._unacknowledged.clear()
        if not self._lossless:
            for entry in held:
                self._drop(entry, "worker_lost")
            return 0
        if held:
            held[0].deaths += 1
            if held[0].deaths >= MAX_DEATHS:
                self._drop(held.pop(0), "worker_killer")
        self._waiting.extendleft(reversed(held))
        frames = sum(len(entry.content.block) for entry in held)
        self.frames_replayed += frames
        return frames

    def abandon(self, reason: str) -> None:
        """Drop all that is held and count it."""
        for entry in [*self._unacknowledged.values(), *self._waiting]:
            self._drop(entry, reason)
        self._unacknowledged.clear()
        self._waiting.clear()

    def _drop(self, entry: Entry, reason: str) -> None:
        frames = len(entry.content.block)
        self.frames_held -= frames
        self.dropped.add(reason, frames)
