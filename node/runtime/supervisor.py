"""The supervisor: keeps the node's child processes alive."""

from __future__ import annotations

import logging
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable

from chachart.node.runtime.child import LACKS, ChildProcess

log = logging.getLogger(__name__)

FIRST_DELAY_S = 0.1
LONGEST_DELAY_S = 5.0
LONG_LIFE_S = 10.0
STILLBORN_LIMIT = 5
"""A process that died so often in a row without ever coming up will not do better next time."""
DEATHS_WINDOW_S = 60.0
UP_WITHIN_S = 120.0


class SupervisedChild:
    """A child process that is started again whenever it dies. One thread calls all but `is_up`.

    Parameters
    ----------
    name
        What log and status call it.
    start
        Starts it.
    on_death
        Called with the process id of one that died, before its successor starts.
    most_deaths
        When it has died so often within a minute, it is given up; None: never for that.
    starts_over
        With this exit code it asks to be started again at once, which is no death.
    tenacious
        Whether one that has ever come up is started again however often it dies before it comes up.

    Attributes
    ----------
    child
        The process, while there is one.
    lacks
        What the last one that died lacked, in its own words; None if it did not die for that.
    last_code
        How the last one that died ended: its exit code, minus the signal's number where one killed it.
    restarts
        How often it had to be started again.
    """

    def __init__(
        self,
        name: str,
        start: Callable[[], ChildProcess],
        on_death: Callable[[int], None],
        most_deaths: int | None = None,
        starts_over: int | None = None,
        tenacious: bool = False,
    ) -> None:
        self.name = name
        self.child: ChildProcess | None = None
        self.restarts = 0
        self.last_code = 0
        self.lacks: str | None = None
        self._start = start
        self._on_death = on_death
        self._most_deaths = most_deaths
        self._starts_over = starts_over
        self._tenacious = tenacious
        self._ever_up = False
        self._up = False
        self._started = 0.0
        self._start_at = 0.0
        self._short_lives = 0
        self._stillborn = 0
        self._deaths: deque[float] = deque()

    @property
    def pid(self) -> int | None:
        """Its process id, None while there is none that has come up."""
        child = self.child
        return None if child is None or not self._up else child.pid

    def check(self) -> str | None:
        """Start it, or see whether it lives; gives a reason to give up, if there is one.

        A process that ended with exit code 0 was told to.
        """
        now = time.monotonic()
        code = None if self.child is None else self.child.exit_code()
        if self.child is not None and code:
            self._bury(self.child, code, now)
        if self.child is not None and not self._up and now - self._started > UP_WITHIN_S:
            log.error("%s (process %d) did not come up within %.0f s", self.name, self.child.pid, UP_WITHIN_S)
            self.child.kill()
        if self._stillborn >= STILLBORN_LIMIT and not (self._tenacious and self._ever_up):
            return f"{self.name} cannot start: it died {self._stillborn} times in a row"
        if self._most_deaths is not None and len(self._deaths) >= self._most_deaths:
            return f"{self.name} died {len(self._deaths)} times within a minute"
        if self.child is None and now >= self._start_at:
            try:
                self.child, self._started, self._up = self._start(), now, False
            except (OSError, MemoryError) as error:  # no descriptor, no memory or no process left just now
                self._start_at = now + LONGEST_DELAY_S
                log.error("%s cannot be started now, but soon again: %s", self.name, error)
        return None

    def is_up(self, pid: int | None = None) -> None:
        """It has come up, and has this process id where that was not known."""
        if self.child is not None and pid is not None:
            self.child.pid = pid
        self._stillborn, self._up, self._ever_up, self.lacks = 0, True, True, None

    @property
    def is_done(self) -> bool:
        """Whether it has ended as it was told to."""
        return self.child is not None and self.child.exit_code() == 0

    def kill_hung(self, pid: int) -> None:
        """End it, if it is still that process: it lives but does nothing."""
        if self.child is not None and self.child.pid == pid:
            self.child.kill()

    def kill(self) -> None:
        """End it now."""
        if self.child is not None:
            self.child.kill()

    def _bury(self, child: ChildProcess, code: int, now: float) -> None:
        child.close()
        self.child, self.last_code = None, code
        if code == self._starts_over:
            self._start_at = now
            self._on_death(child.pid)
            return
        self.restarts += 1
        self.lacks = child.last_error if code == LACKS else None
        self._stillborn += code != LACKS
        self._deaths.append(now)
        while self._deaths[0] < now - DEATHS_WINDOW_S:
            self._deaths.popleft()
        self._short_lives = 0 if now - self._started > LONG_LIFE_S else self._short_lives + 1
        delay = min(FIRST_DELAY_S * 2.0 ** max(0, self._short_lives - 1), LONGEST_DELAY_S)
        self._start_at = now + delay
        cause = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        log.error("%s (process %d) died: %s; restarting it in %.1f s", self.name, child.pid, cause, delay)
        self._on_death(child.pid)


class Supervisor:
    """Looks after several children."""

    def __init__(self, children: Iterable[SupervisedChild]) -> None:
        self.children = list(children)

    def check(self) -> str | None:
        """Look after every one; gives a reason to give up, if there is one."""
        for child in self.children:
            if (reason := child.check()) is not None:
                return reason
        return None

    def kill(self) -> None:
        """End all now."""
        for child in self.children:
            child.kill()

    def close(self, timeout: float) -> None:
        """Wait for all to end by themselves, at most `timeout` seconds, then end them."""
        deadline = time.monotonic() + timeout
        for child in self.children:
            if child.child is not None:
                child.child.close(max(0.0, deadline - time.monotonic()))
