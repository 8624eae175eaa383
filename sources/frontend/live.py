"""What all live links have in common: coming back after unplugging, gathering blocks, a simulated far end."""

from __future__ import annotations

import logging
import time
from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, ClassVar

from pydantic import Field

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.frontend.device import Link
from chachart.sources.frontend.loopback import Loopback, LoopbackSettings, loopback_settings
from chachart.sources.frontend.retry import Backoff
from chachart.sources.frontend.session import Intake

log = logging.getLogger(__name__)

MAX_BLOCK_FRAMES = 64

Packets = Iterable[tuple[str, bytes | bytearray]]
"""Packets, each with the name of the front-end that it came from."""


class LinkLost(Exception):
    """The link has gone."""


class LiveSettings(SourceSettings):
    """What every live link is told."""

    retry_max_s: float = Field(5.0, gt=0)
    """Longest wait between two tries to open a link that has gone; the first is 0.1 s."""
    loopback: LoopbackSettings | bool = False
    """true, or a table: simulate the front-end in this process, at the other end of the link.
    Its keys: `format` (int8, int16 or float32), `corrupt`, `drop`, `reorder` (fractions of the frames),
    `unplug_every_s`, `unplugged_s`, `serial_number`, `fault_seed`, and `scenario`, a simulator's settings."""


class LiveSource(Source):
    """Frames from front-ends on a link that may go and come back.

    Attributes
    ----------
    extra
        The extra of chachart that has its libraries.
    """

    extra: ClassVar[str]

    def __init__(self, settings: LiveSettings, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._intake = Intake(array, self.rejected)
        self._backoff = Backoff(settings.retry_max_s)
        self._loopback: Loopback | None = None
        self._connected = False
        self._reconnects = 0

    def open(self) -> None:
        """Open the link, with a simulated front-end at its other end where `loopback` is set.

        Raises
        ------
        SetupError
            If the link cannot be opened, or its libraries are not installed.
        """
        require(self.extra, "[source]")
        simulated = loopback_settings(self.settings.loopback)
        try:
            if simulated is not None:
                self._loopback = Loopback(simulated, self.array, self._far_end())
            self._connect()
        except SetupError:
            self.close()
            raise
        self._connected = True
        if self._loopback is not None:
            self._loopback.start()

    def recv(self, timeout: float) -> CsiBlock | None:
        """The frames that have come, as a block, or None if none came within `timeout` seconds.

        Raises
        ------
        EndOfSource
            When a simulated front-end has sent all its frames.
        """
        deadline = time.monotonic() + timeout
        while len(self._intake) < MAX_BLOCK_FRAMES:
            came = self._step(0.0 if len(self._intake) else max(deadline - time.monotonic(), 0.0))
            if time.monotonic() >= deadline or (len(self._intake) and not came):
                break
        if not len(self._intake) and self._loopback is not None and self._loopback.finished():
            raise EndOfSource
        return self._intake.take()

    def close(self) -> None:
        """Close the link."""
        if self._loopback is not None:
            self._loopback.stop()
            self._loopback = None
        self._hang_up()
        self._connected = False

    def details(self) -> dict[str, Any]:
        """The link, whether it is open, how often it was opened again, and the front-ends on it."""
        return {
            "link": self.where,
            "connected": self._connected,
            "reconnects": self._reconnects,
            **self._intake.details(),
        }

    def simulated(self) -> dict[str, int]:
        """What the simulated front-end says has become of its frames; nothing where there is none."""
        return {} if self._loopback is None else asdict(self._loopback.report)

    @property
    @abstractmethod
    def where(self) -> str:
        """What the link is called in the log and the status."""

    @abstractmethod
    def _far_end(self) -> Link:
        """The simulated front-end's end of the link."""

    @abstractmethod
    def _connect(self) -> None:
        """Open this end.

        Raises
        ------
        SetupError
            If that cannot be.
        """

    @abstractmethod
    def _packets(self, timeout: float) -> Packets | None:
        """The packets that what has come completes; None if nothing came within `timeout` seconds.

        Raises
        ------
        LinkLost
            If the link has gone.
        """

    @abstractmethod
    def _hang_up(self) -> None:
        """Close this end, if it is open."""

    def _step(self, timeout: float) -> bool:
        """Take what has come, or try to open the link again; whether anything came."""
        if not self._connected:
            self._reconnect(timeout)
            return False
        try:
            packets = self._packets(timeout)
        except LinkLost as error:
            log.warning("%s has gone (%s): trying again until it is back", self.where, error)
            self._hang_up()
            self._connected = False
            self._backoff.failed()
            return False
        host_ns = time.time_ns()
        for name, packet in packets or ():
            self._intake.receive(name, packet, host_ns)
        return packets is not None

    def _reconnect(self, timeout: float) -> None:
        wait = self._backoff.wait_s()
        if wait > 0:
            time.sleep(min(wait, timeout))
            return
        try:
            self._connect()
        except SetupError as error:
            log.debug("%s", error)
            self._backoff.failed()
            return
        self._connected = True
        self._backoff.succeeded()
        self._reconnects += 1
        log.info("%s is back", self.where)
