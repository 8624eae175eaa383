"""The source `can_log`: a bus that python-can has logged, replayed. Lossless."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field, field_validator

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import missing
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.frontend.address import FrontEndAddress, distinct
from chachart.sources.frontend.can_files import SUFFIXES, channel_of, messages, unreadable
from chachart.sources.frontend.packet import max_packet_bytes
from chachart.sources.frontend.session import Intake

if TYPE_CHECKING:
    import can

    from chachart.sources.frontend.isotp_link import IsoTpReceiver

MAX_BLOCK_FRAMES = 64
READ_S = 0.05
"""At full speed a block goes out when it is full or this much time was spent reading."""


class CanLogSettings(SourceSettings):
    """A log of a CAN bus (.blf, .asc or .log) with packets of sources/frontend/PACKET.md over ISO-TP."""

    type: Literal["can_log"] = "can_log"
    """Which source."""
    path: Path = Path("can.blf")
    """The file; its suffix says which format it is."""
    channel: str | None = Field(None, min_length=1, examples=["can0"])
    """The bus, as the log names it: "can0" in .log, "1" in .asc and .blf; not set: all of them."""
    front_ends: tuple[FrontEndAddress, ...] = Field((FrontEndAddress(),), min_length=1)
    """Whose frames are replayed; the same identifier on another bus is another front-end."""
    speed: float = Field(1.0, ge=0)
    """1 plays at the recorded pace, 10 ten times faster, 0 as fast as the node can."""

    @field_validator("front_ends")
    @classmethod
    def _distinct(cls, value: tuple[FrontEndAddress, ...]) -> tuple[FrontEndAddress, ...]:
        return distinct(value)


class CanLog(Source):
    """Replays a log. The host's clock is that of the log."""

    Settings: ClassVar[type[SourceSettings]] = CanLogSettings
    lossless = True
    settings: CanLogSettings

    def __init__(self, settings: CanLogSettings, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._intake = Intake(array, self.rejected)
        self._receivers: dict[str, IsoTpReceiver] = {}
        self._file: IO[Any] | None = None
        self._messages: Iterator[can.Message] = iter(())
        self._next: can.Message | None = None
        self._given = 0
        self._first_s = self._latest_s = self._paced_from_s = 0.0
        self._started: float | None = None

    @classmethod
    def problems(cls, settings: CanLogSettings) -> list[str]:
        """A missing library, a missing file, a format that is not replayed."""
        if problems := missing("can"):
            return problems
        if settings.path.suffix.lower() not in SUFFIXES:
            return [f"path = {str(settings.path)!r}: the name must end in {', '.join(SUFFIXES)}"]
        if not settings.path.is_file():
            return [f"path = {str(settings.path)!r}: there is no such file"]
        return []

    def open(self) -> None:
        """Open the file and read its first message.

        Raises
        ------
        SetupError
            If it cannot be read, holds no message, or a library is missing.
        """
        path = self.settings.path
        if problems := self.problems(self.settings):
            raise SetupError(f"[source] {problems[0]}")
        try:
            self._messages = iter(self._read())
            self._next = next(self._messages, None)
        except unreadable() as error:
            self.close()
            raise SetupError(
                f"[source] {path} is no {path.suffix} log that python-can can read: {error}"
            ) from None
        if self._next is None:
            self.close()
            damaged = self.rejected.total()
            if damaged and not self.settings.channel:
                raise SetupError(
                    f"[source] {path} is no {path.suffix} log that python-can can read: "
                    f"{damaged} damaged lines and no message"
                )
            where = f" on channel {self.settings.channel}" if self.settings.channel else ""
            raise SetupError(f"[source] {path} holds no CAN message{where}")
        self._first_s = self._latest_s = self._paced_from_s = self._next.timestamp

    def recv(self, timeout: float) -> CsiBlock | None:
        """The next frames: as many as a block takes, or at a given pace those that are due.

        Raises
        ------
        EndOfSource
            At the end of the file.
        """
        now = time.monotonic()
        if self._started is None:
            self._started = now
        deadline = now + (timeout if self.settings.speed else READ_S)
        while len(self._intake) < MAX_BLOCK_FRAMES and self._next is not None:
            wait = self._wait_s()
            if wait > 0 and len(self._intake):
                break
            if time.monotonic() + wait >= deadline:
                time.sleep(max(0.0, min(wait, deadline - time.monotonic())))
                break
            time.sleep(wait)
            self._take(self._next)
        if not len(self._intake) and self._next is None:
            raise EndOfSource
        block = self._intake.take()
        self._given += 0 if block is None else len(block)
        return block

    def position(self) -> dict[str, Any]:
        """How many frames it has given."""
        return {"frames": self._given}

    def resume(self, position: dict[str, Any]) -> None:
        """Read the frames again that were given, and let them go."""
        while self._given < position["frames"] and self._next is not None:
            self._take(self._next)
            block = self._intake.take()
            self._given += 0 if block is None else len(block)
        self._paced_from_s = self._latest_s

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def details(self) -> dict[str, Any]:
        """How far it has played, and the front-ends in it."""
        return {"played_s": round(self._latest_s - self._first_s, 3), **self._intake.details()}

    def _read(self) -> Iterable[can.Message]:
        """The messages. The file is opened here because a reader that refuses it would leave it open."""
        path, channel = self.settings.path, self.settings.channel
        if path.suffix.lower() == ".blf":
            self._file = path.open("rb")
        else:
            self._file = path.open("r", encoding="utf-8", errors="replace")
        found = messages(path, self._file, self.rejected)
        return (message for message in found if channel in (None, channel_of(path, message)))

    def _receiver_of(self, channel: str) -> IsoTpReceiver:
        """The receiver of a bus; each has its own, since packets of several would mix."""
        if channel not in self._receivers:
            from chachart.sources.frontend.isotp_link import IsoTpReceiver

            longest = max_packet_bytes(self.array.antennas, self.array.subcarriers)
            self._receivers[channel] = IsoTpReceiver(
                self.settings.front_ends, longest, self.rejected, None, fd=True
            )
        return self._receivers[channel]

    def _wait_s(self) -> float:
        """Seconds until the next message is due."""
        if self.settings.speed == 0 or self._next is None or self._started is None:
            return 0.0
        due = self._started + (self._next.timestamp - self._paced_from_s) / self.settings.speed
        return max(0.0, due - time.monotonic()) if math.isfinite(due) else 0.0

    def _take(self, message: can.Message) -> None:
        if math.isfinite(message.timestamp) and 0 <= message.timestamp < 9e9:
            self._latest_s = message.timestamp
        channel = channel_of(self.settings.path, message)
        for name, packet in self._receiver_of(channel).feed([message]):
            named = name if channel == next(iter(self._receivers)) else f"{name}@{channel}"
            self._intake.receive(named, packet, round(self._latest_s * 1e9))
        try:
            self._next = next(self._messages, None)
        except unreadable():
            self.rejected.add("damaged_log")
            self._next = None
