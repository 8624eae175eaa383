"""When each worker is told to write a snapshot of its state, and what became of it."""

from __future__ import annotations

import logging
import time
from typing import Any

from chachart.node.runtime import messages
from chachart.node.runtime.progress import START, Mark, Marks
from chachart.node.runtime.shard_queues import ShardQueues
from chachart.node.runtime.worker_links import WorkerLinks

log = logging.getLogger(__name__)

MOST_OF_TIME = 0.05
"""Share of the time that may go into writing snapshots, but for those that a bound makes necessary."""
RETRY_S = 5.0
ANSWER_WITHIN_S = 120.0


class Schedule:
    """When the next snapshot of one shard is due. Pure: the clock is passed in.

    Parameters
    ----------
    every_s
        How often; 0 for never.
    """

    def __init__(self, every_s: float) -> None:
        self.error: str | None = None
        self.mark = START
        self._every_s = every_s
        self._asked_at: float | None = None
        self._next = 0.0

    def reset(self, now: float) -> None:
        """The worker is another one, or none: nobody answers any more."""
        self._asked_at = None
        self._next = min(self._next, now + self._every_s)

    def writing(self, now: float) -> bool:
        """Whether an answer is awaited."""
        return self._asked_at is not None and now - self._asked_at < ANSWER_WITHIN_S

    def due(self, now: float, early: bool) -> bool:
        """Whether it is time; `early` is for when blocks would have to go that no snapshot covers."""
        if not self._every_s or self.writing(now):
            return False
        return now >= self._next or (early and self.error is None)

    def asked(self, now: float) -> None:
        self._asked_at = now

    def answered(self, now: float, seconds: float, error: str | None) -> None:
        self._asked_at, self.error = None, error
        self._next = now + (max(self._every_s, seconds / MOST_OF_TIME) if error is None else RETRY_S)


class SnapshotKeeper:
    """Asks the workers for snapshots.

    Parameters
    ----------
    queues, links
        Of all shards.
    every_s
        How often; 0 for never.
    """

    def __init__(self, queues: ShardQueues, links: WorkerLinks, every_s: float) -> None:
        self._queues = queues
        self._links = links
        self._schedules = [Schedule(every_s) for _ in range(len(queues))]

    @property
    def errors(self) -> list[str | None]:
        """By shard, why its last snapshot could not be written."""
        return [schedule.error for schedule in self._schedules]

    @property
    def oldest_mark(self) -> Mark:
        """The lowest of the marks that the workers know."""
        return min((schedule.mark for schedule in self._schedules), key=lambda mark: mark.frame)

    def worker_up(self, shard: int, mark: Mark) -> None:
        """A worker has come up that knows this mark."""
        self._schedules[shard].mark = mark
        self._schedules[shard].reset(time.monotonic())

    def worker_lost(self, shard: int) -> None:
        self._schedules[shard].reset(time.monotonic())

    def newer_mark(self, shard: int, marks: Marks, frame: int) -> dict[str, Any] | None:
        """The latest mark at or below `frame`, where the worker does not know it yet: tell it."""
        schedule, mark = self._schedules[shard], marks.before(frame)
        if mark is None or mark.frame <= schedule.mark.frame:
            return None
        schedule.mark = mark
        return {"frame": mark.frame, "position": mark.position}

    def ask_where_due(self, shard: int, marks: Marks, passed_on: int, early: bool = False) -> None:
        """Ask for a snapshot, if it is time and there is something new to be in it."""
        now = time.monotonic()
        with self._queues.shard(shard) as queue:
            idle = queue.last_seq == queue.covered_seq
            if queue.replaying or idle or not self._schedules[shard].due(now, early):
                return
        self.ask(shard, marks, passed_on)

    def ask(self, shard: int, marks: Marks, passed_on: int) -> None:
        """Ask for a snapshot of what has been sent.

        Parameters
        ----------
        shard, marks
            Whose, and the reader's marks.
        passed_on
            All frames below this number are in the queues.
        """
        with self._queues.shard(shard) as queue:
            unsent = queue.unsent_from
        mark = self.newer_mark(shard, marks, passed_on if unsent is None else min(unsent, passed_on))
        if self._links.send(shard, messages.SNAPSHOT, {"mark": mark}):
            self._schedules[shard].asked(time.monotonic())

    def answered(self, shard: int, values: dict[str, Any]) -> None:
        """A worker has written its snapshot, or could not."""
        schedule, error = self._schedules[shard], values["error"]
        if error is not None and schedule.error is None:
            log.error("worker %d: its snapshot cannot be written: %s", shard, error)
        elif error is None and schedule.error is not None:
            log.warning("worker %d: snapshots are written again", shard)
        schedule.answered(time.monotonic(), values["seconds"], error)
        with self._queues.shard(shard) as queue:
            queue.can_snapshot = error is None
            if error is None:
                queue.cover(values["seq"])

    def writing(self) -> bool:
        """Whether an answer is awaited from anybody who is there."""
        now = time.monotonic()
        return any(
            schedule.writing(now) and peer is not None
            for schedule, peer in zip(self._schedules, self._links.peers, strict=True)
        )
