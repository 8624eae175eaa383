"""What a recording holds in all, as kept at its end."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import NoneType
from typing import Any, Self

import numpy as np

from chachart.node.data.csi import CsiBlock
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.mcap_chunks import ChunkSpan


@dataclass(frozen=True, slots=True)
class Totals:
    """How many frames of how many UEs, from when to when, and the longest time (ns) one message covers."""

    frames: int
    ues: int
    start_ns: int | None
    end_ns: int | None
    span_ns: int

    @classmethod
    def parse(cls, values: Mapping[str, str]) -> Self | None:
        """The totals in a file's metadata, JSON each; None where they are not all there."""
        try:
            numbers = {f.name: json.loads(values[f.name]) for f in fields(cls)}
        except (KeyError, ValueError, RecursionError):
            return None
        times = (numbers["start_ns"], numbers["end_ns"])
        counts = (numbers["frames"], numbers["ues"], numbers["span_ns"])
        if any(type(n) is not int for n in counts) or any(type(t) not in (int, NoneType) for t in times):
            return None
        return cls(**numbers)


@dataclass(slots=True)
class Account:
    """Running account of the frames of a recording."""

    frames: int = 0
    start_ns: int | None = None
    end_ns: int | None = None
    span_ns: int = 0
    ues: set[int] = field(default_factory=set)

    def add(self, block: CsiBlock) -> None:
        """Count a block."""
        first, last = int(block.time_ns.min()), int(block.time_ns.max())
        self.frames += len(block)
        self.start_ns = first if self.start_ns is None else min(first, self.start_ns)
        self.end_ns = last if self.end_ns is None else max(last, self.end_ns)
        self.span_ns = max(self.span_ns, last - first)
        self.ues.update(np.unique(block.ue).tolist())

    def totals(self) -> Totals:
        """The account so far."""
        return Totals(self.frames, len(self.ues), self.start_ns, self.end_ns, self.span_ns)


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """What a recording holds.

    `start_ns` and `end_ns` are the times of its earliest and latest frame, None in an empty recording;
    `closed_properly` is False where the writer was killed (or still writes); `damaged` counts chunks and
    messages that were unreadable, by reason, where the file had to be read through; `size` in bytes.
    """

    array: ArrayGeometry
    note: Mapping[str, Any]
    facts: CaptureFacts
    frames: int
    ues: int
    start_ns: int | None
    end_ns: int | None
    closed_properly: bool
    damaged: Mapping[str, int]
    size: int

    @property
    def seconds(self) -> float:
        """Time from the earliest frame to the latest, in seconds."""
        return 0.0 if self.start_ns is None or self.end_ns is None else (self.end_ns - self.start_ns) / 1e9


def density(chunks: Sequence[ChunkSpan], start_ns: int, end_ns: int, bins: int) -> list[float]:
    """Which share of the bytes of `chunks` lies in each of `bins` equal parts of that time."""
    chunks = sorted(chunks, key=lambda chunk: chunk.start_ns)
    length = max((end_ns - start_ns) / 1e9, 1e-9)
    starts = np.array([(chunk.start_ns - start_ns) / 1e9 for chunk in chunks])
    shares = np.cumsum([chunk.length for chunk in chunks]) / max(sum(chunk.length for chunk in chunks), 1)
    before = np.interp(np.linspace(0.0, length, bins + 1), [*starts, length], [0.0, *shares])
    parts: list[float] = np.diff(before).round(6).tolist()
    return parts
