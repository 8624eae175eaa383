"""How far the frames of a source have got: what goes into snapshots, so that somebody else can go on.

A *mark* is a number of the reader's and the position that the source had when it had given all frames below.
*Applied* says what is in the workers' state: a list of (shards, shard, frame), each of which says that of all
UEs that belong to `shard` when there are `shards` of them, every frame below `frame` is in.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.runtime.partition import shard_of

Applied = list[tuple[int, int, int]]


@dataclass(frozen=True, slots=True)
class Mark:
    """All frames below `frame` came before `position`; None where the source cannot go back there."""

    frame: int
    position: dict[str, Any] | None


START = Mark(0, None)
"""Before the first frame."""


class Marks:
    """The marks that a reader has made, thinned out. One thread adds, another asks."""

    def __init__(self, most: int = 1024) -> None:
        self._marks: list[Mark] = []
        self._most = most

    def add(self, mark: Mark) -> None:
        """A newer one."""
        marks = [*self._marks, mark]
        self._marks = marks if len(marks) <= self._most else marks[len(marks) % 2 :: 2]

    def before(self, frame: int) -> Mark | None:
        """The latest one at or below `frame`, if there is one."""
        marks = self._marks
        at = int(np.searchsorted([mark.frame for mark in marks], frame, "right"))
        return marks[at - 1] if at else None


def missing(ue: NDArray[np.uint64], numbers: NDArray[np.int64], applied: Applied) -> NDArray[np.bool_]:
    """Which of these frames are in nobody's state yet."""
    wanted = np.ones(len(ue), np.bool_)
    for shards, shard, frame in applied:
        wanted &= (numbers >= frame) | (shard_of(ue, shards) != shard)
    return wanted


def highest(applied: Iterable[tuple[int, int, int]]) -> Applied:
    """The same without what others say already."""
    frames: dict[tuple[int, int], int] = {}
    for shards, shard, frame in applied:
        frames[shards, shard] = max(frame, frames.get((shards, shard), 0))
    return [(*key, frame) for key, frame in frames.items()]
