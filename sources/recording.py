"""A recording as a source: at the recorded pace, faster, or as fast as the node can; lossless."""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingReader
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.checks import usable

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
        self._blocks: Generator[CsiBlock] | None = None
        self._waiting: CsiBlock | None = None
        self._started: float | None = None
        self._first_ns = self._latest_ns = 0

    @classmethod
    def carried_array(cls, settings: RecordingSettings) -> ArrayGeometry | None:
        """The array in the file."""
        return RecordingReader(settings.path).array

    @classmethod
    def problems(cls, settings: RecordingSettings) -> list[str]:
        """Whether the file can be read and has frames between `from_s` and `to_s`."""
        try:
            reader = RecordingReader(settings.path)
            if next(reader.blocks(*_range(reader, settings)), None) is None:
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
        self._blocks = self._play(reader)
        self._waiting = next(self._blocks, None)
        if self._waiting is None:
            raise SetupError(_empty(self.settings))
        self._first_ns = self._latest_ns = int(self._waiting.time_ns.min())

    def recv(self, timeout: float) -> CsiBlock | None:
        """The next block: all of it, or at a given pace the frames that are due."""
        if self._waiting is None or self._blocks is None:
            raise EndOfSource
        ready = len(self._waiting) if self.settings.speed == 0 else self._due(self._waiting, timeout)
        if not ready:
            return None
        block = self._waiting.cut(0, ready)
        more = ready < len(self._waiting)
        self._waiting = self._waiting.cut(ready, len(self._waiting)) if more else next(self._blocks, None)
        block = replace(block, array=self.array.name, seq=self._played)
        self._played += len(block)
        self._latest_ns = max(self._latest_ns, int(block.time_ns.max()))
        return block

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
        }

    def _play(self, reader: RecordingReader) -> Generator[CsiBlock]:
        """The blocks of every round, later rounds shifted in time so that they go on from the one before."""
        shift_ns = 0
        while not self.settings.loops or self._rounds < self.settings.loops:
            first_ns, last_ns, frames = None, 0, 0
            for block in reader.blocks(*_range(reader, self.settings)):
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
            shift_ns += (last_ns - first_ns) + max((last_ns - first_ns) // frames, 1)

    def _due(self, block: CsiBlock, timeout: float) -> int:
        """How many frames of `block` are due; waits up to `timeout` seconds for the first ones."""
        due: NDArray[np.int64] = np.maximum.accumulate(block.time_ns)
        ready = int(np.searchsorted(due, self._media_ns(), "right"))
        if not ready:
            wait = (int(due[0]) - self._media_ns()) / self.settings.speed / 1e9
            time.sleep(min(max(wait, TICK_S), timeout))
            ready = int(np.searchsorted(due, self._media_ns(), "right"))
        return ready

    def _media_ns(self) -> int:
        """The recording's time now."""
        now = time.monotonic()
        if self._started is None:
            self._started = now
        return self._first_ns + int((now - self._started) * self.settings.speed * 1e9)


def _range(reader: RecordingReader, settings: RecordingSettings) -> tuple[int | None, int | None]:
    start = reader.start_ns or 0
    first = start + round(settings.from_s * 1e9) if settings.from_s else None
    return first, None if settings.to_s is None else start + round(settings.to_s * 1e9)


def _empty(settings: RecordingSettings) -> str:
    if not settings.from_s and settings.to_s is None:
        return f"{settings.path} holds no frames"
    end = "its end" if settings.to_s is None else f"{settings.to_s:g} s"
    return f"{settings.path} holds no frames from {settings.from_s:g} s to {end}"
