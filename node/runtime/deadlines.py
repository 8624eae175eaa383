"""When a process that lives has to be taken for one that hangs. Pure: the clock is passed in."""

from __future__ import annotations

LEAST_S = 5.0
FIRST_S = 60.0
"""For the first block of all, of which nobody knows how long it takes."""
TYPICAL_FACTOR = 20.0
STALLED_S = 2.0


class Patience:
    """For how long one process has owed a sign of life.

    Time in which it waited for a core does not count: on a busy machine everything is slow. Whoever asks may
    have been stopped itself, with the whole machine for instance: the full time begins anew then.
    """

    def __init__(self) -> None:
        self._asked: float | None = None
        self._since = 0.0
        self._fair_from = 0.0
        self._waited_then = 0.0

    def overdue_s(self, now: float, since: float, waited_s: float) -> float:
        """Seconds in which it could have given a sign of life and did not.

        Parameters
        ----------
        now, since
            Monotonic seconds: now, and since when it owes one; another `since` begins anew.
        waited_s
            For how long it has waited for a core, ever.
        """
        if self._asked is None or now - self._asked > STALLED_S:
            self._fair_from, self._waited_then = now, waited_s
        if since != self._since:
            self._since, self._waited_then = since, waited_s
        self._asked = now
        return now - max(since, self._fair_from) - (waited_s - self._waited_then)


class Deadlines:
    """Tells a worker that hangs from a slow one: a block may take twenty times as long as others do."""

    def __init__(self) -> None:
        self._patience = Patience()

    def missed(
        self,
        now: float,
        heard_at: float,
        oldest_sent_at: float | None,
        typical_s: float | None,
        waited_s: float = 0.0,
    ) -> str | None:
        """Why a worker hangs, or None.

        Parameters
        ----------
        now, heard_at
            Monotonic seconds: now, and when it last sent anything; an idle worker does twice a second.
        oldest_sent_at
            When its oldest unacknowledged block was sent, or None.
        typical_s
            How long a block takes, or None before the first.
        waited_s
            For how long it has waited for a core, ever.
        """
        if oldest_sent_at is None:
            silent = self._patience.overdue_s(now, heard_at, waited_s)
            return f"not heard of for {silent:.0f} s" if silent > LEAST_S else None
        limit = FIRST_S if typical_s is None else max(LEAST_S, TYPICAL_FACTOR * typical_s)
        waits = self._patience.overdue_s(now, oldest_sent_at, waited_s)
        return f"a block waits for its answer for {waits:.0f} s" if waits > limit else None
