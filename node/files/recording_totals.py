"""What a recording holds in all, as kept at its end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import NoneType
from typing import Self

import numpy as np

from chachart.node.data.csi import CsiBlock


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
