"""Frames of one transmission, as several arrays have received it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.csi import CsiBlock
from chachart.node.estimation.snapshots import WAITING
from chachart.node.estimation.state import Snapshot

Complex = NDArray[np.complex64]

LATEST_MS = 500.0
"""Frames of an array that lags behind the others by more than this do not join theirs."""
LATE_MS = 100.0
"""An array that has gone on by so much has not received what is missing of it."""
SILENT_MS = 2000.0
"""An array that nobody has heard of for so long is not waited for."""


FIELDS = ("ue", "time_ns", "csi", "position", "packet")


@dataclass(frozen=True)
class Events:
    """E transmissions, in the order of their UEs and times.

    Attributes
    ----------
    ue, time_ns
        Who (E,), and when the last array received it (E,).
    frames
        One complex64 (E, N, S) an array, zeros where it has not received it.
    count
        Frames in it (E,).
    position
        Known positions (E, 3), NaN where unknown.
    """

    ue: NDArray[np.uint64]
    time_ns: NDArray[np.int64]
    frames: list[Complex]
    count: NDArray[np.int64]
    position: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.ue)

    def take(self, which: NDArray[np.bool_]) -> Events:
        """Some of them."""
        frames = [f[which] for f in self.frames]
        return Events(self.ue[which], self.time_ns[which], frames, self.count[which], self.position[which])


class Gathering:
    """Holds frames until those of the other arrays are there, or can be expected no longer.

    Parameters
    ----------
    shapes
        Antennas and tones of each array.
    window_ms
        Frames of a UE that follow each other within this time are of one transmission, where they do not say
        by a number (`CsiBlock.packet`) of which they are.
    frames
        So many frames of a UE at each array, within `LATEST_MS` from one to the next, are taken together.
    """

    def __init__(self, shapes: Sequence[tuple[int, int]], window_ms: float, frames: int = 1) -> None:
        self._shapes = list(shapes)
        self._frames = frames
        self._window_ns = round(window_ms * 1e6)
        self._patience_ns = round(max(LATEST_MS, 2 * window_ms) * 1e6)
        self._held: list[tuple[int, CsiBlock]] = []
        self._late_ns = round(max(LATE_MS, 2 * window_ms) * 1e6)
        self._newest_ns = np.iinfo(np.int64).min
        self._heard_ns: NDArray[np.int64] | None = None

    @property
    def held(self) -> int:
        """Frames that wait for others."""
        return sum(len(block) for _, block in self._held)

    def add(self, array: int, block: CsiBlock) -> None:
        """Take the frames of an array (its number)."""
        self._held.append((array, block))
        newest = int(block.time_ns.max())
        self._newest_ns = max(self._newest_ns, newest)
        if self._heard_ns is None:
            self._heard_ns = np.full(len(self._shapes), int(block.time_ns.min()))
        self._heard_ns[array] = max(self._heard_ns[array], newest)

    def waiting(self) -> Snapshot:
        """The frames that wait, and until when each array has been heard: `restore` takes them up again.

        Arrays `waiting.<number>.<field>`, of no frame where none waits.
        """
        found: Snapshot = {}
        for number, (antennas, tones) in enumerate(self._shapes):
            held = [block for array, block in self._held if array == number]
            found |= {
                f"{WAITING}{number}.ue": _stacked([b.ue for b in held], (0,), np.uint64),
                f"{WAITING}{number}.time_ns": _stacked([b.time_ns for b in held], (0,), np.int64),
                f"{WAITING}{number}.csi": _stacked([b.csi for b in held], (0, antennas, tones), np.complex64),
                f"{WAITING}{number}.position": _stacked([_positions(b) for b in held], (0, 3), np.float32),
                f"{WAITING}{number}.packet": _stacked([_packets(b) for b in held], (0,), np.uint64),
            }
        heard = np.zeros(0, np.int64) if self._heard_ns is None else self._heard_ns
        return found | {f"{WAITING}heard_ns": heard}

    def restore(self, snapshot: Snapshot) -> None:
        """Go on with what `waiting` gave; with nothing where a snapshot has none."""
        self._held, self._heard_ns, self._newest_ns = [], None, np.iinfo(np.int64).min
        knows = f"{WAITING}0.ue" in snapshot  # older ones have none
        for number in range(len(self._shapes)):
            found: dict[str, Any] = {n: snapshot[f"{WAITING}{number}.{n}"] for n in FIELDS if knows}
            if len(found.get("ue", ())):
                self.add(number, CsiBlock("", 0, **found))
        heard = snapshot[f"{WAITING}heard_ns"] if knows else np.zeros(0, np.int64)
        if len(heard) == len(self._shapes):
            self._heard_ns = heard.copy()
            self._newest_ns = int(heard.max())

    def ready(self, everything: bool = False) -> Events | None:
        """Transmissions that are complete or overdue, or all there are; None if there is none."""
        if not self._held or self._heard_ns is None:
            return None
        ue = np.concatenate([block.ue for _, block in self._held])
        time_ns = np.concatenate([block.time_ns for _, block in self._held])
        array = np.repeat([a for a, _ in self._held], [len(block) for _, block in self._held])
        packet = np.concatenate([_packets(block) for _, block in self._held])
        event, last = self._events(ue, packet, time_ns)
        heard = np.zeros((len(last), len(self._shapes)), np.bool_)
        heard[event, array] = True
        if self._frames > 1:
            heard &= np.bincount(event, minlength=len(last))[:, None] >= self._frames * len(self._shapes)
        heard |= self._heard_ns > last[:, None] + self._late_ns
        heard |= self._heard_ns < self._newest_ns - SILENT_MS * 1e6
        done = heard.all(axis=1) | (last < self._newest_ns - self._patience_ns) | everything
        if not done.any():
            return None
        found = self._joined(event, done, ue, last)
        self._keep(~done[event])
        return found

    def _events(
        self, ue: NDArray[np.uint64], packet: NDArray[np.uint64], time_ns: NDArray[np.int64]
    ) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """Of which transmission each frame is, in the order of UEs and times, and when it was heard last."""
        order = np.lexsort((time_ns, packet, ue))
        who, which, when = ue[order], packet[order], time_ns[order]
        alone = self._window_ns if self._frames == 1 else self._patience_ns
        apart = np.where(which[1:] == 0, alone, self._patience_ns)
        new = (np.diff(when) > apart) | (who[1:] != who[:-1]) | (which[1:] != which[:-1])
        starts = np.concatenate([[0], np.flatnonzero(new) + 1])
        last = np.append(when[starts[1:] - 1], when[-1])
        ranked = np.lexsort((last, who[starts]))
        rank = np.empty(len(ranked), np.intp)
        rank[ranked] = np.arange(len(ranked))
        event = np.empty(len(ue), np.intp)
        event[order] = np.repeat(rank, np.diff(np.append(starts, len(ue))))
        return event, last[ranked]

    def _joined(
        self,
        event: NDArray[np.intp],
        done: NDArray[np.bool_],
        ue: NDArray[np.uint64],
        last: NDArray[np.int64],
    ) -> Events:
        number = np.cumsum(done) - 1
        count = int(done.sum())
        frames = [np.zeros((count, *shape), np.complex64) for shape in self._shapes]
        frames_in = np.zeros(count, np.int64)
        position = np.full((count, 3), np.nan, np.float32)
        who = np.zeros(count, np.uint64)
        start = 0
        for array, block in self._held:
            its = event[start : start + len(block)]
            start += len(block)
            rows = np.flatnonzero(done[its])
            into = number[its[rows]]
            add_in_phase(frames[array], into, block.csi[rows])
            np.add.at(frames_in, into, 1)
            who[into] = block.ue[rows]
            if block.position is not None:
                known = np.isfinite(block.position[rows]).all(axis=1)
                position[into[known]] = block.position[rows][known]
        return Events(who, last[done], frames, frames_in, position)

    def _keep(self, waiting: NDArray[np.bool_]) -> None:
        kept, start = [], 0
        for array, block in self._held:
            mine = waiting[start : start + len(block)]
            start += len(block)
            if mine.any():
                kept.append((array, block if mine.all() else block.take(mine)))
        self._held = kept


def _packets(block: CsiBlock) -> NDArray[np.uint64]:
    return np.zeros(len(block), np.uint64) if block.packet is None else block.packet


def _positions(block: CsiBlock) -> NDArray[np.float32]:
    return np.full((len(block), 3), np.nan, np.float32) if block.position is None else block.position


def _stacked(parts: list[NDArray[Any]], empty: tuple[int, ...], dtype: type) -> NDArray[Any]:
    return np.concatenate([np.zeros(empty, dtype), *parts])


def add_in_phase(total: Complex, into: NDArray[np.intp], csi: Complex) -> None:
    """Add frames (K, N, S) to `total[into]`, each turned to the phase of what is there already."""
    left = np.arange(len(into))
    while len(left):
        _, first = np.unique(into[left], return_index=True)
        now = left[first]
        there = total[into[now]]
        product = np.einsum("kns,kns->k", csi[now].conj(), there)
        size = np.abs(product)
        turn = np.where(size > 0, product / np.maximum(size, np.float32(1e-37)), np.complex64(1))
        total[into[now]] = there + turn[:, None, None] * csi[now]
        left = np.delete(left, first)
