"""The source `can_log`: a bus that python-can has logged, replayed. Lossless."""

from __future__ import annotations

import math
import struct
import time
import zlib
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
from chachart.sources.frontend.packet import max_packet_bytes
from chachart.sources.frontend.session import Intake

if TYPE_CHECKING:
    import can

    from chachart.sources.frontend.isotp_link import IsoTpReceiver

SUFFIXES = (".blf", ".asc", ".log")
"""The formats of python-can that keep CAN FD messages whole."""
MAX_BLOCK_FRAMES = 64
READ_S = 0.05
"""At full speed a block goes out when it is full or this much time was spent reading."""


class CanLogSettings(SourceSettings):
    """A log of a CAN bus (.blf, .asc or .log) with packets of sources/frontend/PACKET.md over ISO-TP."""

    type: Literal["can_log"] = "can_log"
    """Which source."""
    path: Path = Path("can.blf")
    """The file; its suffix says which format it is."""
    front_ends: tuple[FrontEndAddress, ...] = Field((FrontEndAddress(),), min_length=1)
    """Whose frames are replayed."""
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
        self._receiver: IsoTpReceiver | None = None
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
        from chachart.sources.frontend.isotp_link import IsoTpReceiver

        self._receiver = IsoTpReceiver(
            self.settings.front_ends,
            max_packet_bytes(self.array.antennas, self.array.subcarriers),
            self.rejected,
            None,
            fd=True,
        )
        try:
            self._messages = iter(self._read())
            self._next = next(self._messages, None)
        except _unreadable() as error:
            self.close()
            raise SetupError(
                f"[source] {path} is no {path.suffix} log that python-can can read: {error}"
            ) from None
        if self._next is None:
            self.close()
            raise SetupError(f"[source] {path} holds no CAN message")
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
        import can

        path = self.settings.path
        if path.suffix.lower() == ".blf":
            binary = self._file = path.open("rb")
            return can.BLFReader(binary)
        text = self._file = path.open("r", encoding="utf-8", errors="replace")
        if path.suffix.lower() == ".asc":
            return can.ASCReader(text, relative_timestamp=False)
        return can.CanutilsLogReader(text)

    def _wait_s(self) -> float:
        """Seconds until the next message is due."""
        if self.settings.speed == 0 or self._next is None or self._started is None:
            return 0.0
        due = self._started + (self._next.timestamp - self._paced_from_s) / self.settings.speed
        return max(0.0, due - time.monotonic()) if math.isfinite(due) else 0.0

    def _take(self, message: can.Message) -> None:
        assert self._receiver is not None
        if math.isfinite(message.timestamp) and 0 <= message.timestamp < 9e9:
            self._latest_s = message.timestamp
        for name, packet in self._receiver.feed([message]):
            self._intake.receive(name, packet, round(self._latest_s * 1e9))
        try:
            self._next = next(self._messages, None)
        except _unreadable():
            self.rejected.add("damaged_log")
            self._next = None


def _unreadable() -> tuple[type[Exception], ...]:
    """What python-can's readers raise on files that are damaged or something else."""
    import can
    from can.io.blf import BLFParseError

    plain = (ValueError, LookupError, TypeError, OverflowError, EOFError, OSError, struct.error, zlib.error)
    return (*plain, BLFParseError, can.CanError)
