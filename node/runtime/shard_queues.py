"""The shards' queues as the feeder's two threads share them: the reader puts, the dispatcher takes."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from chachart.node.data.counters import Counters
from chachart.node.runtime.entries import Entry
from chachart.node.runtime.partition import ShardBlock
from chachart.node.runtime.shard_queue import ShardQueue


class ShardQueues:
    """One `ShardQueue` per worker behind one lock.

    Parameters
    ----------
    queues
        The shards' queues.
    lossless
        Whether `put` waits for room.
    wake
        Called when there is something new to take.
    """

    def __init__(self, queues: list[ShardQueue], lossless: bool, wake: Callable[[], None]) -> None:
        self._queues = queues
        self._lossless = lossless
        self._wake = wake
        self._condition = threading.Condition()
        self._abandoned: str | None = None

    def __len__(self) -> int:
        return len(self._queues)

    @contextmanager
    def shard(self, shard: int) -> Iterator[ShardQueue]:
        """One shard's queue, for whoever needs more than is here; whoever waits for room looks afterwards."""
        with self._condition:
            yield self._queues[shard]
            self._condition.notify_all()

    def put(self, content: ShardBlock) -> None:
        """Add a block; waits for room where nothing may be dropped."""
        queue = self._queues[content.shard]
        with self._condition:
            while self._lossless and queue.full and self._abandoned is None:
                self._condition.wait()
            news = queue.put(content)
            if self._abandoned is not None:
                queue.abandon(self._abandoned)
        if news:
            self._wake()

    def take(self, shard: int, method: tuple[str, str], now: float, round_: int) -> Entry | None:
        """The next block for the worker of `shard`, if it has credit."""
        with self._condition:
            entry = self._queues[shard].next_to_send(method, now, round_)
            if entry is not None:
                self._condition.notify_all()
            return entry

    def deadline(self) -> float:
        """When `take` will have something to give though nothing happens until then; infinity for never."""
        with self._condition:
            deadlines = [queue.deadline() for queue in self._queues]
        return min((deadline for deadline in deadlines if deadline is not None), default=math.inf)

    def acknowledge(
        self, shard: int, seqs: Sequence[int], estimated: int, rejected: Mapping[str, int], now: float
    ) -> list[ShardBlock]:
        """See `ShardQueue.acknowledge`."""
        with self._condition:
            return self._queues[shard].acknowledge(seqs, estimated, rejected, now)

    def abandon(self, reason: str) -> None:
        """Drop all that is held, and whatever is still put, and count it."""
        with self._condition:
            self._abandoned = reason
            for queue in self._queues:
                queue.abandon(reason)
            self._condition.notify_all()

    def settle(self, frames_in: int, reason: str) -> None:
        """Count as dropped what came in and is neither estimated, dropped nor held."""
        with self._condition:
            held = sum(queue.frames_held for queue in self._queues)
            if missing := frames_in - held - self._accounted():
                self._queues[0].dropped.add(reason, missing)

    def accounted(self) -> int:
        """Frames that were estimated or dropped."""
        with self._condition:
            return self._accounted()

    def dropped_here(self) -> dict[str, int]:
        """Frames that did not get to a worker, by reason."""
        dropped = Counters()
        with self._condition:
            for queue in self._queues:
                dropped.merge(queue.dropped.as_dict())
        return dropped.as_dict()

    @property
    def empty(self) -> bool:
        """Whether no block waits or is unacknowledged."""
        with self._condition:
            return not any(queue.blocks_held for queue in self._queues)

    def totals(self) -> tuple[int, Counters, list[dict[str, Any]]]:
        """Frames estimated, frames rejected or dropped, and how each shard is."""
        dropped = Counters()
        with self._condition:
            for queue in self._queues:
                dropped.merge(queue.rejected.as_dict())
                dropped.merge(queue.dropped.as_dict())
            shards = [
                {
                    "frames_estimated": queue.frames_estimated,
                    "frames_replayed": queue.frames_replayed,
                    "backlog_frames": queue.frames_held,
                    "backlog_blocks": queue.blocks_held,
                    "state_lost": queue.state_lost,
                    "ues_reset": queue.ues_reset,
                    "retained_bytes": queue.retained_bytes,
                }
                for queue in self._queues
            ]
            return sum(queue.frames_estimated for queue in self._queues), dropped, shards

    def _accounted(self) -> int:
        return sum(q.frames_estimated + q.rejected.total() + q.dropped.total() for q in self._queues)
