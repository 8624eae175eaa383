"""A simulated front-end in a thread of the node's own, at the other end of the node's own link."""

from __future__ import annotations

import threading
import time

from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.frontend.device import FaultSettings, Link, Report, SimulatedFrontEnd
from chachart.sources.simulator import Simulator, SimulatorSettings

SETTLE_S = 0.3
"""After the last packet was sent it has arrived within this time."""


class LoopbackSettings(FaultSettings):
    """A simulated front-end at the other end of the link, in this process: nothing needs to be plugged in."""

    scenario: SimulatorSettings = SimulatorSettings()
    """What it measures."""


def loopback_settings(value: LoopbackSettings | bool) -> LoopbackSettings | None:
    """The settings behind a `loopback` key: a table of them, true for the defaults, false for none."""
    if isinstance(value, bool):
        return LoopbackSettings() if value else None
    return value


class Loopback:
    """Runs the simulated front-end.

    Parameters
    ----------
    settings, array
        What it plays.
    link
        Its end of the line.
    """

    def __init__(self, settings: LoopbackSettings, array: ArrayGeometry, link: Link) -> None:
        self._link = link
        self._device = SimulatedFrontEnd(Simulator(settings.scenario, array), link, settings)
        self._thread = threading.Thread(target=self._device.run, name="front-end", daemon=True)
        self._over: float | None = None

    @property
    def report(self) -> Report:
        """What it has sent so far."""
        return self._device.report

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def finished(self) -> bool:
        """Whether it has sent everything, long enough ago to have arrived."""
        if self._thread.ident is None or self._thread.is_alive():
            return False
        if self._over is None:
            self._over = time.monotonic()
        return time.monotonic() - self._over >= SETTLE_S

    def stop(self) -> None:
        """End it and close its end of the line."""
        self._link.stopping.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._link.close()
