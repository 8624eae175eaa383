"""How each array does: which part of the transmissions it hears, and how far its clock is off."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.fft import ifft

from chachart.node.data.placement import Placement
from chachart.node.estimation.fusion.certainty import Fused
from chachart.node.estimation.fusion.events import Events
from chachart.node.estimation.fusion.fuser import Clock
from chachart.node.estimation.fusion.site import OVERSAMPLING, Complex, Floats, Site

MEMORY = 500.0
"""Transmissions that shares are of."""
SAMPLES = 101
"""Transmissions whose median offsets are."""
SURE = 0.1
"""A position that is an outlier with more than this probability tells nothing of clocks."""
LEAST_SAMPLES = 3
"""With fewer, nobody knows how far they spread."""
MEDIAN = 1.2533
"""Deviation of a median against that of a mean."""
LEAST_SHARE = 0.5
"""Nor does an array of whose energy less comes on one path from there."""


class ArrayWatch:
    """Watches transmissions and where they were found to come from.

    Parameters
    ----------
    sites
        The arrays.
    clock
        What they share: where they share none, clocks are not looked at.
    placements
        What calibration has said of each, and is taken off already.
    """

    def __init__(self, sites: Sequence[Site], clock: Clock, placements: Sequence[Placement]) -> None:
        self._sites, self._clock, self._placements = tuple(sites), clock, tuple(placements)
        self._heard = np.zeros(len(self._sites))
        self._count = 0.0
        self._late: list[deque[float]] = [deque(maxlen=SAMPLES) for _ in self._sites]

    def see(self, events: Events, fused: Fused) -> None:
        """Transmissions and their positions; clocks are looked at in one of them."""
        decay = np.exp(-len(events) / MEMORY)
        heard = np.stack([frame.reshape(len(events), -1).any(axis=1) for frame in events.frames])
        self._heard = decay * self._heard + heard.sum(axis=1)
        self._count = decay * self._count + len(events)
        if self._clock == "own":
            return
        i = int(np.argmin(fused.outlier))
        if not fused.outlier[i] <= SURE:
            return
        late = {}
        for b, frame in enumerate(events.frames):
            metres = self._lateness_m(b, frame[i], fused.position[i]) if heard[b, i] else None
            if metres is not None:
                late[b] = metres
        common = float(np.median(list(late.values()))) if self._clock == "offset" and late else 0.0
        for b, metres in late.items():
            self._late[b].append((metres - common) / self._sites[b].light_speed_m_s * 1e9)

    def report(self) -> list[dict[str, Any]]:
        """One map an array: {name, heard, transmissions, offset_ns, offset_std_ns, drift_ns}.

        The offset is what calibration has said, if anything, and the drift what is seen besides; its
        deviation is that of both. None where unknown; without a calibration there is no drift.
        """
        found = []
        for b, (site, place) in enumerate(zip(self._sites, self._placements, strict=True)):
            told = None if place.offset_s is None or self._clock == "own" else 1e9 * place.offset_s
            late = np.array(self._late[b])
            offset, std = told, None if told is None else 1e9 * place.offset_std_s
            drift = float(np.median(late)) if len(late) else None
            if drift is not None:
                spread = 1.4826 * float(np.median(np.abs(late - drift)))
                offset = drift + (told or 0.0)
                seen = float(np.hypot(MEDIAN * spread / np.sqrt(len(late)), std or 0.0))
                std = seen if len(late) >= LEAST_SAMPLES else None
            found.append(
                {
                    "name": site.name,
                    "heard": float(self._heard[b]),
                    "transmissions": self._count,
                    "offset_ns": offset,
                    "offset_std_ns": std,
                    "drift_ns": None if told is None else drift,
                }
            )
        return found

    def _lateness_m(self, number: int, frame: Complex, position: Floats) -> float | None:
        """By how much the strongest path from there is later than the distance says; None if it is weak."""
        site = self._sites[number]
        point = position[None, None]
        rho = site.ranges(point)[0]
        beamed = (site.match(point, rho) @ frame[None])[0, 0]
        delays = OVERSAMPLING * len(beamed)
        power = np.abs(ifft(beamed, delays, norm="forward")) ** 2
        top = int(power.argmax())
        if power[top] < LEAST_SHARE * site.samples * float(np.sum(np.abs(frame) ** 2)):
            return None
        left, middle, right = power[top - 1], power[top], power[(top + 1) % delays]
        bend = left - 2 * middle + right
        fine = top + (0.5 * (left - right) / bend if bend < 0 else 0.0)
        late = fine * site.unambiguous_m / delays - float(rho[0, 0])
        half = site.unambiguous_m / 2
        return float((late + half) % site.unambiguous_m - half)
