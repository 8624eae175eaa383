"""When to try again what has failed."""

from __future__ import annotations

import time
from collections.abc import Callable

FIRST_S = 0.1


class Backoff:
    """Doubles the wait from 0.1 s to `longest_s` with every failure, until a success.

    >>> now = [0.0]
    >>> backoff = Backoff(1.0, lambda: now[0])
    >>> backoff.failed(), backoff.wait_s()
    (None, 0.1)
    >>> backoff.failed(), backoff.wait_s()
    (None, 0.2)
    """

    def __init__(self, longest_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._longest_s = longest_s
        self._clock = clock
        self._next_s = FIRST_S
        self._at = clock()

    def failed(self) -> None:
        """Something failed: wait."""
        self._at = self._clock() + self._next_s
        self._next_s = min(2 * self._next_s, self._longest_s)

    def succeeded(self) -> None:
        """It works: the next failure waits briefly again."""
        self._next_s = FIRST_S

    def wait_s(self) -> float:
        """Seconds until the next try, 0 if it is due."""
        return max(0.0, self._at - self._clock())
