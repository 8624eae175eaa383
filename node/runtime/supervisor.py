"""Keeps the workers alive: sees one die, says so, and starts its successor."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

from chachart.node.runtime.child import Child

log = logging.getLogger(__name__)

FIRST_DELAY_S = 0.1
LONGEST_DELAY_S = 5.0
LONG_LIFE_S = 10.0
STILLBORN_LIMIT = 5
"""A worker that died so often in a row without ever saying hello will not do better next time."""


@dataclass(slots=True, eq=False)
class Post:
    """One worker's place: who is there, or when the next one starts."""

    shard: int
    child: Child | None = None
    started: float = 0.0
    start_at: float = 0.0
    restarts: int = 0
    short_lives: int = 0
    stillborn: int = 0


class Supervisor:
    """Starts `count` workers and restarts those that die.

    Parameters
    ----------
    count
        How many.
    start
        Starts the worker of a shard.
    on_death
        Told shard and process id of a worker that died, before its successor starts.
    """

    def __init__(
        self, count: int, start: Callable[[int], Child], on_death: Callable[[int, int], None]
    ) -> None:
        self.posts = [Post(shard) for shard in range(count)]
        self._start = start
        self._on_death = on_death

    def check(self) -> str | None:
        """Look after every worker; gives a reason to give up, if there is one.

        A worker that ended with exit code 0 was told to.
        """
        now = time.monotonic()
        for post in self.posts:
            code = None if post.child is None else post.child.exit_code()
            if post.child is not None and code:
                self._bury(post, post.child, code, now)
            if post.stillborn >= STILLBORN_LIMIT:
                return f"worker {post.shard} cannot start: it died {post.stillborn} times in a row"
            if post.child is None and now >= post.start_at:
                post.child, post.started = self._start(post.shard), now
        return None

    def hello(self, shard: int) -> None:
        """That worker is up."""
        self.posts[shard].stillborn = 0

    def kill(self) -> None:
        """End all workers now."""
        for post in self.posts:
            if post.child is not None:
                post.child.kill()

    def close(self, timeout: float) -> None:
        """Wait for all workers to end by themselves, at most `timeout` seconds, then end them."""
        deadline = time.monotonic() + timeout
        for post in self.posts:
            if post.child is not None:
                post.child.close(max(0.0, deadline - time.monotonic()))

    def _bury(self, post: Post, child: Child, code: int, now: float) -> None:
        child.close()
        post.child = None
        post.restarts += 1
        post.stillborn += 1
        post.short_lives = 0 if now - post.started > LONG_LIFE_S else post.short_lives + 1
        delay = min(FIRST_DELAY_S * 2.0 ** max(0, post.short_lives - 1), LONGEST_DELAY_S)
        post.start_at = now + delay
        cause = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        log.error(
            "worker %d (process %d) died: %s; restarting it in %.1f s", post.shard, child.pid, cause, delay
        )
        self._on_death(post.shard, child.pid)
