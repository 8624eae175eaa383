"""Looks for workers that live but do nothing."""

from __future__ import annotations

import logging
import platform
from collections.abc import Iterator

from chachart.node.runtime.core_time import CoreTime
from chachart.node.runtime.deadlines import Deadlines
from chachart.node.runtime.shard_queues import ShardQueues
from chachart.node.runtime.worker_links import WorkerLinks

log = logging.getLogger(__name__)


class HungWorkers:
    """Tells them from slow ones by when they answer.

    Attributes
    ----------
    reasons
        By shard, why its worker hangs, until another one is there.
    """

    def __init__(self, links: WorkerLinks, queues: ShardQueues) -> None:
        self.reasons: list[str | None] = [None] * len(queues)
        self._links = links
        self._queues = queues
        self._deadlines = [Deadlines() for _ in self.reasons]
        self._core_time = CoreTime()

    def look(self, now: float) -> Iterator[tuple[int, int]]:
        """Shard and process id of those that hang at `now`, in monotonic seconds."""
        for shard, peer in enumerate(self._links.peers):
            if peer is None:
                continue
            with self._queues.shard(shard) as queue:
                oldest, typical_s = queue.oldest_sent_at(), queue.typical_s
            here = peer.host == platform.node()
            waited_s = self._core_time.waited_s(peer.pid) if here else 0.0
            reason = self._deadlines[shard].missed(now, peer.heard_at, oldest, typical_s, waited_s)
            if reason is not None:
                self.reasons[shard] = f"worker {shard} hangs: {reason}"
                log.error("worker %d (process %d) hangs: %s", shard, peer.pid, reason)
                self._core_time.forget(peer.pid)
                yield shard, peer.pid

    def worker_up(self, shard: int) -> None:
        """Another one is there."""
        self.reasons[shard] = None
        self._deadlines[shard] = Deadlines()
