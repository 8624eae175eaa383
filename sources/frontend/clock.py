"""A front-end's clock in terms of ours.

A frame measured at device time t arrives at host time `t + offset + drift t + delay` with a delay that is
never negative and mostly small. So the smallest `host - device` of each second lies close to the line
`offset + drift t`, whatever the worst ones do, and the median slope between those minima (Theil and Sen)
does not mind seconds in which every frame was late.
"""

from __future__ import annotations

from collections import deque
from itertools import combinations
from statistics import median
from typing import Any

WINDOW_NS = 1_000_000_000
WINDOWS = 60
"""Drift is measured over the last so many windows."""
MIN_WINDOWS = 5
JUMP_NS = 1_000_000_000
"""A clock this far off its line has been set, not drifted."""


class DeviceClock:
    """Follows offset and drift of one device's clock.

    Attributes
    ----------
    drift
        How much faster the host's clock runs than the device's, as a fraction.
    jumps
        How often the device's clock was set.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._forget()

    def _forget(self) -> None:
        self.drift = 0.0
        self._started: bool = False
        self._fitted: bool = False
        self._base = self._lowest = (0, 0)
        self._window_end = 0
        self._minima: deque[tuple[int, int]] = deque(maxlen=WINDOWS)

    def observe(self, device_ns: int, host_ns: int) -> int:
        """A frame of device time `device_ns` arrived at host time `host_ns`; its host time by the line.

        Device time 0 means that the device has no clock: then it is `host_ns`.
        """
        if device_ns == 0:
            return host_ns
        offset = host_ns - device_ns
        if self._started and offset < self._line(device_ns) - JUMP_NS:
            self.jumps += 1
            self._forget()
        if not self._started:
            self._started = True
            self._base = (device_ns, offset)
            self._lowest = (device_ns, offset)
            self._window_end = host_ns + WINDOW_NS
        elif host_ns >= self._window_end:
            self._close_window()
            self._lowest = (device_ns, offset)
            self._window_end = host_ns + WINDOW_NS
        elif offset - self._line(device_ns) < self._lowest[1] - self._line(self._lowest[0]):
            self._lowest = (device_ns, offset)
        if not self._fitted and offset < self._base[1]:
            self._base = (device_ns, offset)
        return device_ns + self._line(device_ns)

    def details(self) -> dict[str, Any]:
        """`offset_s` (host minus device, latest), `drift_ppm`, `jumps`."""
        offset = self._line(self._lowest[0]) if self._started else 0
        return {
            "offset_s": round(offset / 1e9, 6),
            "drift_ppm": round(self.drift * 1e6, 3),
            "jumps": self.jumps,
        }

    def _line(self, device_ns: int) -> int:
        return self._base[1] + round(self.drift * (device_ns - self._base[0]))

    def _close_window(self) -> None:
        lowest = self._lowest
        if lowest[1] > self._line(lowest[0]) + JUMP_NS:
            self.jumps += 1
            self._forget()
            self._started = True
            self._base = lowest
        self._minima.append(lowest)
        if len(self._minima) < MIN_WINDOWS:
            return
        slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in combinations(self._minima, 2) if b[0] > a[0]]
        if slopes:
            self.drift = median(slopes)
            self._fitted = True
            time, reference = self._minima[-1]
            level = median(o - reference - self.drift * (t - time) for t, o in self._minima)
            self._base = (time, reference + round(level))
