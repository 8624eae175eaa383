"""What every source of CSI is.

A source lives in its own process, in the hands of the runtime: `open`, then `recv` until `EndOfSource`, then
`close`. It knows the data types and nothing of who reads them. Drivers are imported in `open`, so that a
missing one only matters to whoever asks for it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Any, ClassVar, Self

from pydantic import Field

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import RequestError
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.settings import Settings
from chachart.node.net.security import SecuritySettings


class EndOfSource(Exception):
    """Raised by `Source.recv` when no frame will ever come again."""


class SourceSettings(Settings):
    """What every source's table in a configuration has."""

    type: str
    """Which source."""
    array: str | tuple[str, ...] | None = Field(None, examples=["north"])
    """Name of the [[array]] that it measures with, where there are several; not set: the one in the same
    place. A list of names where one source has the frames of several."""

    def listens_on(self) -> str | None:
        """The one endpoint that it takes for itself; None where it takes none, or any that is free."""
        return None

    def exposure(self, security: SecuritySettings) -> list[str]:
        """Why people who should not could reach it, as mistakes of the configuration."""
        return []


class Source(ABC):
    """Where CSI comes from.

    Attributes
    ----------
    Settings
        The settings model of this source, found by `type`.
    lossless
        True: the node makes the source wait and never drops a frame (a recording). False: the world does not
        wait (an array); when the node is too slow the oldest waiting block is dropped and counted.
    rejected
        What came in and was no usable frame, counted by reason.
    complaint
        What was wrong with the last of it, in words for people; None where nothing was.
    security, others
        `[security]`, and further arrays whose frames come; whoever runs the source sets them before `open`.
    catching_up
        Set by whoever reads: some UEs have had these frames already, others not, so that a pause has to wait.
    """

    Settings: ClassVar[type[SourceSettings]]
    lossless: bool = False
    security: SecuritySettings = SecuritySettings()
    others: tuple[ArrayGeometry, ...] = ()
    catching_up: bool = False

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        self.settings = settings
        self.array = array
        self.rejected = Counters()
        self.complaint: str | None = None

    @classmethod
    def carried_array(cls, settings: Any) -> ArrayGeometry | None:
        """The array that the source itself describes (a recording does), or None.

        Raises
        ------
        SetupError
            If the source cannot be read.
        """
        return None

    @classmethod
    def carried_others(cls, settings: Any) -> tuple[ArrayGeometry, ...]:
        """Further arrays that the source describes, as `carried_array`.

        Raises
        ------
        SetupError
            If the source cannot be read.
        """
        return ()

    @classmethod
    def carried_area(cls, settings: Any) -> tuple[float, float, float, float] | None:
        """Lower and higher corner of where its UEs can be, where the source knows it.

        Raises
        ------
        SetupError
            If the source cannot be read.
        """
        return None

    @classmethod
    def carried_facts(cls, settings: Any) -> CaptureFacts:
        """What the source knows of its frames' phase and delay; by default those of an array with a clock.

        Raises
        ------
        SetupError
            If the source cannot be read.
        """
        return CaptureFacts()

    @classmethod
    def problems(cls, settings: Any) -> list[str]:
        """What would keep the source from opening, as far as can be told without opening it."""
        return []

    @abstractmethod
    def open(self) -> None:
        """Take hold of files, ports and devices.

        Raises
        ------
        SetupError
            If one of them cannot be had.
        """

    @abstractmethod
    def recv(self, timeout: float) -> CsiBlock | None:
        """The next block, or None if none came within `timeout` seconds.

        Raises
        ------
        EndOfSource
            When the source has nothing more to give.
        """

    def position(self) -> dict[str, Any] | None:
        """Where the source is: plain values with which `resume` goes on behind the last frame that it gave.

        None for a source that cannot go back: what a live one has not delivered is gone.
        """
        return None

    def resume(self, position: dict[str, Any]) -> None:
        """Called after `open` and before the first `recv`: go on where an earlier one was.

        Parameters
        ----------
        position
            What `position` gave, possibly in another process. Called only where it gave something.
        """

    def close(self) -> None:
        """Let go of what `open` took. May be called twice."""

    def details(self) -> dict[str, Any]:
        """What a status display may show of this source beyond counts: plain msgpack values."""
        return {}

    def replay(
        self, *, paused: bool | None = None, speed: float | None = None, at_s: float | None = None
    ) -> dict[str, Any]:
        """Pause, go on, change the speed or jump, as far as given; how it plays now. From any thread.

        Raises
        ------
        RequestError
            If the source is no replay, or there is no such time.
        """
        raise RequestError(f"the source is {self.settings.type}: only a recording can be paused or wound")

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
