"""The time of a recording while it is played: it goes on at some speed, stands still, or jumps."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Playback:
    """The recording's time now, in ns. Thread-safe.

    Parameters
    ----------
    speed
        How many seconds of the recording pass in one; 0 is as fast as it can be read.
    monotonic
        The host's clock, in seconds.

    Attributes
    ----------
    changed
        Set on every change, for whoever waits meanwhile.
    """

    def __init__(self, speed: float, monotonic: Callable[[], float] = time.monotonic) -> None:
        self.changed = threading.Event()
        self._speed = speed
        self._paused = False
        self._monotonic = monotonic
        self._since = 0.0
        self._from_ns: int | None = None
        self._lock = threading.Lock()

    @property
    def speed(self) -> float:
        """See the parameter."""
        return self._speed

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._paused

    def start(self, media_ns: int) -> None:
        """It is that time now."""
        with self._lock:
            self._from_ns, self._since = media_ns, self._monotonic()

    @property
    def started(self) -> bool:
        """Whether it has a time yet."""
        return self._from_ns is not None

    def now_ns(self) -> int:
        """The time; 0 before `start`."""
        with self._lock:
            return self._now_ns()

    def change(self, *, paused: bool | None = None, speed: float | None = None) -> None:
        """Pause or go on, at another speed where one is given; time does not jump."""
        with self._lock:
            if self._from_ns is not None:
                self._from_ns, self._since = self._now_ns(), self._monotonic()
            self._paused = self._paused if paused is None else paused
            self._speed = self._speed if speed is None else speed
        self.changed.set()

    def wait(self, seconds: float) -> None:
        """Wait so long, less if something changes."""
        self.changed.wait(seconds)
        self.changed.clear()

    def _now_ns(self) -> int:
        if self._from_ns is None:
            return 0
        passed = 0.0 if self._paused else (self._monotonic() - self._since) * self._speed
        return self._from_ns + int(passed * 1e9)
