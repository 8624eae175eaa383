"""Looks at the antennas now and then while frames come in, in the reader's thread; dead ones are left out."""

from __future__ import annotations

import logging
import time
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.angle_delay import angle_delay
from chachart.node.estimation.antennas import AntennaWatch, response

log = logging.getLogger(__name__)

LOOK_EVERY_S = 0.1
FRAMES_A_LOOK = 2
"""The next blocks wait meanwhile, .4 ms at 32 x 32: rather a few frames often than many now and then."""
KEPT_FRAMES = 8
WATCHED_S = 5.0
"""So long after somebody asked, a UE's newest frames are kept."""


class AntennaLooks:
    """One thread calls `see`, any thread asks."""

    def __init__(self, array: ArrayGeometry) -> None:
        self._watch = AntennaWatch(array)
        self._report: dict[str, Any] = {}
        self._dead_since: dict[str, float] = {}
        self._dead = np.zeros(0, np.intp)
        self._next = 0.0
        self._array = array
        self._watched: tuple[int, float] | None = None
        self._seen: tuple[int, deque[tuple[int, Any]]] | None = None

    def see(self, block: CsiBlock, now: float) -> None:
        """A block came in."""
        watched = self._watched
        if watched is not None:
            if now > watched[1]:
                self._watched = self._seen = None
            elif len(rows := np.flatnonzero(block.ue == np.uint64(watched[0]))):
                if self._seen is None or self._seen[0] != watched[0]:
                    self._seen = (watched[0], deque(maxlen=KEPT_FRAMES))
                self._seen[1].append((int(block.time_ns[rows[-1]]), block.csi[rows[-1]].copy()))
        if now >= self._next:
            self._next = now + LOOK_EVERY_S
            self._watch.look(block, FRAMES_A_LOOK)
            self._tell(self._watch.report(), now)

    def without_dead(self, block: CsiBlock) -> CsiBlock:
        """A block in which antennas that look dead have weight 0: their noise would only do harm."""
        if not len(self._dead):
            return block
        csi = block.csi.copy()
        csi[:, self._dead] = 0
        return replace(block, csi=csi)

    def report(self) -> dict[str, Any]:
        """See `AntennaWatch.report`; `dead_s` says for how long dead antennas have been so, by number."""
        report, since = self._report, self._dead_since
        if not since:
            return report
        now = time.monotonic()
        return report | {"dead_s": {number: now - then for number, then in since.items()}}

    def of_ue(self, ue: int) -> dict[str, Any]:
        """See `NodeAccess.antennas`."""
        self._watched = (ue, time.monotonic() + WATCHED_S)
        seen = self._seen
        if seen is None or seen[0] != ue:
            return {}
        frames = list(seen[1])
        csi = np.stack([frame for _, frame in frames])
        calibration = self._array.calibration
        picture = angle_delay(csi if calibration is None else calibration.apply(csi), self._array)
        return {"ue": ue, "time_ns": frames[-1][0], **response(csi[-1]), **picture}

    def _tell(self, report: dict[str, Any], now: float) -> None:
        before, faults = self._report.get("faults", {}), report.get("faults", {})
        for number, fault in faults.items():
            if before.get(number) != fault:
                log.warning("antenna %s looks %s", number, fault)
        for number in before.keys() - faults.keys():
            log.info("antenna %s is well again", number)
        self._report = report
        dead = [number for number, fault in faults.items() if fault == "dead"]
        self._dead_since = {number: self._dead_since.get(number, now) for number in dead}
        self._dead = np.array([int(number) for number in dead], np.intp)
