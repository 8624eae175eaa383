"""A recording as a source: at the recorded pace, faster, or as fast as the node can; lossless."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import RequestError, SetupError
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingReader
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.checks import usable
from chachart.sources.playback import Playback

DENSITY_BINS = 200
TICK_S = 0.002
"""At a given pace, frames come in blocks of at least so much time."""


class RecordingSettings(SourceSettings):
    """`type = "recording"`: CSI from a file that the recorder or `chachart import` wrote."""

    type: Literal["recording"] = "recording"
    path: Path = Path("recording.mcap")
    """The file; it carries its own array."""
    speed: float = Field(1.0, ge=0)
    """1 plays at the recorded pace, 10 ten times faster, 0 as fast as the node can."""
    from_s: float = Field(0.0, ge=0)
    """Where to begin, in seconds from the start of the recording."""
    to_s: float | None = Field(None, gt=0)
    """Where to stop, in seconds from the start of the recording; not set: at its end."""
    loops: int = Field(1, ge=0)
    """How many times to play it; 0 plays it for ever. Times go on from one round to the next."""

    at_end: Literal["end", "stay"] = "end"
    """What comes after the last frame: the node ends, or it stays and can be told to go back."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError(f"to_s = {self.to_s:g} must be after from_s = {self.from_s:g}")
        return self


class Recording(Source):
    """Plays a recording. Frames are numbered as they are played."""

    Settings: ClassVar[type[SourceSettings]] = RecordingSettings
    lossless = True
    settings: RecordingSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._played = 0
        self._rounds = 0
        self._reader: RecordingReader | None = None
        self._blocks: Generator[CsiBlock] | None = None
        self._waiting: CsiBlock | None = None
        self._played_from: dict[str, Any] | None = None
        self._playback = Playback(self.settings.speed)
        self._jump_s: float | None = None
        self._first_ns = self._latest_ns = self._shift_ns = 0

    @classmethod
    def carried_array(cls, settings: RecordingSettings) -> ArrayGeometry | None:
        """The array in the file."""
        return RecordingReader(settings.path).array

    @classmethod
    def carried_facts(cls, settings: RecordingSettings) -> CaptureFacts:
        """The facts in the file."""
        return RecordingReader(settings.path).facts

    @classmethod
    def carried_others(cls, settings: RecordingSettings) -> tuple[ArrayGeometry, ...]:
        """The other arrays in the file."""
        return RecordingReader(settings.path).arrays[1:]

    @classmethod
    def carried_area(cls, settings: RecordingSettings) -> tuple[float, float, float, float] | None:
        """What the importer noted."""
        area = RecordingReader(settings.path).note.get("area_m")
        return None if area is None else (area[0], area[1], area[2], area[3])

    @classmethod
    def problems(cls, settings: RecordingSettings) -> list[str]:
        """Whether the file can be read and has frames between `from_s` and `to_s`."""
        try:
            reader = RecordingReader(settings.path)
            if next(reader.blocks(*_range(reader, settings, settings.from_s)), None) is None:
                return [_empty(settings)]
        except SetupError as error:
            return [str(error)]
        return []

    def open(self) -> None:
        """Open the file.

        Raises
        ------
        SetupError
            If it cannot be read, has another array, or no frames between `from_s` and `to_s`.
        """
        reader = RecordingReader(self.settings.path)
        if differences := reader.array.mismatches(self.array):
            raise SetupError(f"{self.settings.path} has another array: {'; '.join(differences)}")
        self.rejected = reader.damaged
        self._reader = reader
        self._blocks = self._play(reader, self.settings.from_s)
        self._waiting = next(self._blocks, None)
        if self._waiting is None:
            raise SetupError(_empty(self.settings))
        self._first_ns = self._latest_ns = int(self._waiting.time_ns.min())

    def recv(self, timeout: float) -> CsiBlock | None:
        """The next block: all of it, or at a given pace the frames that are due."""
        jump, self._jump_s = self._jump_s, None
        if jump is not None:
            self._jump_to(jump)
        if self._waiting is None or self._blocks is None:
            if self.settings.at_end == "end" or self._reader is None:
                raise EndOfSource
            self._playback.wait(timeout)
            return None
        paused = self._playback.paused
        if paused and not self.catching_up:
            self._playback.wait(timeout)
            return None
        if not self._playback.started:
            self._playback.start(self._first_ns)
        at_once = paused or self._playback.speed == 0
        ready = len(self._waiting) if at_once else self._due(self._waiting, timeout)
        if not ready:
            return None
        block = self._waiting.cut(0, ready)
        more = ready < len(self._waiting)
        self._waiting = self._waiting.cut(ready, len(self._waiting)) if more else next(self._blocks, None)
        theirs = any(block.array == other.name for other in self.others)
        block = replace(block, array=block.array if theirs else self.array.name, seq=self._played)
        self._played += len(block)
        self._latest_ns = max(self._latest_ns, int(block.time_ns.max()))
        return block

    def position(self) -> dict[str, Any]:
        """How many frames it has played, and since when without a jump."""
        return {"frames": self._played, "from": self._played_from}

    def resume(self, position: dict[str, Any]) -> None:
        """Skip what has been played, in every round since the last jump."""
        jump = position["from"]
        if jump is not None:
            self._rounds = jump["rounds"]
            self._jump_to(jump["at_s"])
            self._played = jump["frames"]
            self._played_from = jump
        while self._waiting is not None and self._blocks is not None and self._played < position["frames"]:
            skipped = min(len(self._waiting), position["frames"] - self._played)
            self._played += skipped
            more = skipped < len(self._waiting)
            self._waiting = (
                self._waiting.cut(skipped, len(self._waiting)) if more else next(self._blocks, None)
            )
        if self._waiting is not None:
            self._latest_ns = int(self._waiting.time_ns.min())
            self._playback.start(self._latest_ns)

    def close(self) -> None:
        """Let go of the file."""
        if self._blocks is not None:
            self._blocks.close()
            self._blocks = None

    def details(self) -> dict[str, Any]:
        """How far it has played."""
        return {
            "path": str(self.settings.path),
            "frames": self._played,
            "seconds": (self._latest_ns - self._first_ns) / 1e9,
            "rounds": self._rounds,
            "replay": self._replay(),
        }

    def replay(
        self, *, paused: bool | None = None, speed: float | None = None, at_s: float | None = None
    ) -> dict[str, Any]:
        """See `Source.replay`; adds `density`, the frames in each of equal parts of the recording."""
        if self._reader is None:
            raise RequestError("the recording is closed")
        length = self._length_s()
        if at_s is not None and not 0 <= at_s <= length:
            raise RequestError(f"at_s must be from 0 to {length:g}, the recording's length, not {at_s:g}")
        if paused is False and self._waiting is None and at_s is None:
            at_s = self.settings.from_s
        if at_s is not None:
            self._jump_s = at_s
        self._playback.change(paused=paused, speed=speed)
        return {**self._replay(), "density": self._reader.density(DENSITY_BINS)}

    def _replay(self) -> dict[str, Any]:
        """How it plays, for people."""
        start_ns = self._reader.start_ns if self._reader is not None else None
        length_s, ended = self._length_s(), self._waiting is None and self._jump_s is None
        at_s = (self._latest_ns - self._shift_ns - (start_ns or 0)) / 1e9
        at_s = length_s if ended else min(max(at_s, 0.0), length_s)
        return {
            "at_s": at_s if self._jump_s is None else self._jump_s,
            "length_s": length_s,
            "start_ns": start_ns,
            "paused": self._playback.paused,
            "speed": self._playback.speed,
            "ended": ended,
        }

    def _length_s(self) -> float:
        reader = self._reader
        if reader is None or reader.start_ns is None or reader.end_ns is None:
            return 0.0
        return (reader.end_ns - reader.start_ns) / 1e9

    def _jump_to(self, at_s: float) -> None:
        """Play on from there."""
        assert self._reader is not None
        if self._blocks is not None:
            self._blocks.close()
        self._shift_ns = 0
        self._rounds = min(self._rounds, max(self.settings.loops - 1, 0))
        self._played_from = {"frames": self._played, "rounds": self._rounds, "at_s": at_s}
        self._blocks = self._play(self._reader, at_s)
        self._waiting = next(self._blocks, None)
        if self._waiting is not None:
            self._latest_ns = int(self._waiting.time_ns.min())
            self._playback.start(self._latest_ns)

    def _play(self, reader: RecordingReader, from_s: float) -> Generator[CsiBlock]:
        """The blocks of every round, later rounds shifted in time so that they go on from the one before.

        The first round begins at `from_s`.
        """
        while not self.settings.loops or self._rounds < self.settings.loops:
            first_ns, last_ns, frames = None, 0, 0
            shift_ns = self._shift_ns
            for block in reader.blocks(*_range(reader, self.settings, from_s)):
                good = usable(block, self.rejected)
                if good is None:
                    continue
                first_ns = int(good.time_ns.min()) if first_ns is None else first_ns
                last_ns = max(last_ns, int(good.time_ns.max()))
                frames += len(good)
                yield replace(good, time_ns=good.time_ns + shift_ns) if shift_ns else good
            if first_ns is None:
                return
            self._rounds += 1
            from_s = self.settings.from_s
            self._shift_ns += (last_ns - first_ns) + max((last_ns - first_ns) // frames, 1)

    def _due(self, block: CsiBlock, timeout: float) -> int:
        """How many frames of `block` are due; waits up to `timeout` seconds for the first ones."""
        due: NDArray[np.int64] = np.maximum.accumulate(block.time_ns)
        ready = int(np.searchsorted(due, self._playback.now_ns(), "right"))
        if not ready:
            wait = (int(due[0]) - self._playback.now_ns()) / self._playback.speed / 1e9
            self._playback.wait(min(max(wait, TICK_S), timeout))
            ready = int(np.searchsorted(due, self._playback.now_ns(), "right"))
        return ready


def _range(
    reader: RecordingReader, settings: RecordingSettings, from_s: float
) -> tuple[int | None, int | None]:
    start = reader.start_ns or 0
    first = start + round(from_s * 1e9) if from_s else None
    return first, None if settings.to_s is None else start + round(settings.to_s * 1e9)


def _empty(settings: RecordingSettings) -> str:
    if not settings.from_s and settings.to_s is None:
        return f"{settings.path} holds no frames"
    end = "its end" if settings.to_s is None else f"{settings.to_s:g} s"
    return f"{settings.path} holds no frames from {settings.from_s:g} s to {end}"
