"""When a process that lives has to be taken for one that hangs. Pure: the clock is passed in."""

from __future__ import annotations

LEAST_S = 5.0
FIRST_S = 60.0
"""For the first block of all, of which nobody knows how long it takes."""
TYPICAL_FACTOR = 20.0
STALLED_S = 2.0


class Deadlines:
    """Tells hung workers from slow ones: a block may take twenty times as long as others do.

    Whoever asks may have been stopped itself, with the whole machine for instance: everybody then gets the
    full time anew.
    """

    def __init__(self) -> None:
        self._asked: float | None = None
        self._fair_from = 0.0

    def missed(
        self, now: float, heard_at: float, oldest_sent_at: float | None, typical_s: float | None
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
        """
        if self._asked is not None and now - self._asked > STALLED_S:
            self._fair_from = now
        self._asked = now
        if oldest_sent_at is None:
            silent = now - max(heard_at, self._fair_from)
            return f"not heard of for {silent:.0f} s" if silent > LEAST_S else None
        limit = FIRST_S if typical_s is None else max(LEAST_S, TYPICAL_FACTOR * typical_s)
        waits = now - max(oldest_sent_at, self._fair_from)
        return f"a block waits for its answer for {waits:.0f} s" if waits > limit else None
