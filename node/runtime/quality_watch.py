"""Works out how good the chart is, every few seconds, in a thread that yields to everything else."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from chachart.config.settings import QualitySettings
from chachart.node.chart import ChartUpdate
from chachart.node.estimation.quality import assess
from chachart.node.geometry import ArrayGeometry

log = logging.getLogger(__name__)

FEWEST_UES = 4
"""With fewer, no figure means anything."""
NICENESS = 15
"""The thread's; the estimates come first."""
MOST_OF_TIME = 0.1
"""Share of the time that may go into quality, however long one report takes."""


class QualityWatch:
    """Reports on the chart while it runs, and once more at the end.

    Parameters
    ----------
    settings, array
        `[quality]`, and the array that the positions are seen from.
    chart
        Gives the chart as it stands.
    publish
        Takes each report.
    """

    def __init__(
        self,
        settings: QualitySettings,
        array: ArrayGeometry,
        chart: Callable[[], ChartUpdate | None],
        publish: Callable[[dict[str, Any]], None],
    ) -> None:
        self.latest: dict[str, Any] | None = None
        self._settings = settings
        self._array = array
        self._chart = chart
        self._publish = publish
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="quality", daemon=True)

    def start(self) -> None:
        """Begin to report."""
        self._thread.start()

    def finish(self) -> None:
        """Stop reporting, but for one last report on the whole chart."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()
        self.report()

    def report(self) -> None:
        """Work out a report now; none where too few positions are known."""
        chart = self._chart()
        if chart is None or chart.position is None:
            return
        known = np.flatnonzero(np.isfinite(chart.position).all(axis=1))
        if len(known) < FEWEST_UES:
            return
        try:
            report = assess(chart.take(known), self._array, self._settings.k, self._settings.exact_ues)
        except ValueError as error:
            log.warning("no quality report: %s", error)
            return
        self.latest = report
        self._publish(report)

    def _run(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        wait = self._settings.every_s
        while not self._stopping.wait(wait):
            started = time.monotonic()
            self.report()
            wait = max(self._settings.every_s, (time.monotonic() - started) / MOST_OF_TIME)
