"""How much one may ask: counts of what was turned away, and rates by whom."""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable

from chachart.node.data.counters import Counters

TELL_EVERY_S = 60.0
REMEMBERED = 4096
"""So many askers are told apart; who was quiet for longest is forgotten first."""
GUESSES_PER_S, GUESSES_AT_ONCE = 0.2, 10
"""Wrong tokens that an address may try."""

log = logging.getLogger(__name__)


class Refusals(Counters):
    """Counts what was turned away, by reason, and tells the log once a minute and reason.

    Parameters
    ----------
    who
        What refuses, as the log calls it.
    """

    def __init__(self, who: str) -> None:
        super().__init__()
        self._who = who
        self._tell_at: dict[str, float] = {}
        self._lock = threading.Lock()

    def add(self, reason: str, n: int = 1) -> None:
        """Count `n` more for `reason`."""
        with self._lock:
            super().add(reason, n)
        now = time.monotonic()
        if n and now >= self._tell_at.get(reason, 0.0):
            self._tell_at[reason] = now + TELL_EVERY_S
            log.warning("%s: turned away, %s; %s so far", self._who, reason.replace("_", " "), self)


class RateLimit:
    """So many a second in the long run and some more at once, for each asker (a token bucket each).

    Parameters
    ----------
    per_s
        In the long run.
    at_once
        After a while of silence.
    clock
        Seconds, for tests.
    """

    def __init__(self, per_s: float, at_once: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._per_s = per_s
        self._at_once = at_once
        self._clock = clock
        self._left: OrderedDict[Hashable, tuple[float, float]] = OrderedDict()

    def wait_s(self, who: Hashable) -> float:
        """How long `who` must wait before the next one is due; 0 if it is now."""
        left = self._now(who)
        return 0.0 if left >= 1 else (1 - left) / self._per_s

    def take(self, who: Hashable) -> bool:
        """Whether `who` may have one more now; if so, it is taken."""
        left = self._now(who)
        allowed = left >= 1
        self._left[who] = (left - allowed, self._clock())
        self._left.move_to_end(who)
        if len(self._left) > REMEMBERED:
            self._left.popitem(last=False)
        return allowed

    def _now(self, who: Hashable) -> float:
        now = self._clock()
        left, then = self._left.get(who, (self._at_once, now))
        return min(self._at_once, left + (now - then) * self._per_s)
