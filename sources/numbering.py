"""One numbering of the frames of several producers, each of which numbers its own.

A block is a *duplicate* if the same producer has sent the same number and content before; it is *late* if its
number lies in a gap; a low number otherwise is a producer that counts anew. Gaps and late blocks stay visible
in the numbers that are given: whoever reads the source counts them.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable

from chachart.node.data.csi import CsiBlock

REMEMBERED_BLOCKS = 1024
"""Duplicates are recognised among so many blocks of a producer."""
REMEMBERED_GAPS = 1024
REMEMBERED_PRODUCERS = 1024
LONGEST_GAP = 10_000_000
"""A jump in the numbering by more frames is a producer that counts anew."""


class _Producer:
    """Where one producer is in its own numbering."""

    def __init__(self, first: int) -> None:
        self.expected = first
        self._gaps: OrderedDict[int, int] = OrderedDict()  # first frame to one past the last
        self._recent: OrderedDict[tuple[int, int], None] = OrderedDict()

    def is_duplicate(self, seq: int, content: int) -> bool:
        """Whether it has sent that before; from now on it has."""
        if (seq, content) in self._recent:
            return True
        self._recent[seq, content] = None
        if len(self._recent) > REMEMBERED_BLOCKS:
            self._recent.popitem(last=False)
        return False

    def open_gap(self, stop: int) -> None:
        """Frames from the expected one up to `stop` are missing so far."""
        self._gaps[self.expected] = stop
        if len(self._gaps) > REMEMBERED_GAPS:
            self._gaps.popitem(last=False)

    def fills_gap(self, start: int, stop: int) -> bool:
        """Whether these frames were missing; they are no longer."""
        for first, last in self._gaps.items():
            if first <= start and stop <= last:
                del self._gaps[first]
                if first < start:
                    self._gaps[first] = start
                if stop < last:
                    self._gaps[stop] = last
                return True
        return False

    def begin_anew(self, seq: int) -> None:
        """It counts from there."""
        self.expected = seq
        self._gaps.clear()


class Numbering:
    """Gives blocks their numbers.

    Attributes
    ----------
    restarts
        How often a producer has begun to count anew.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._producers: OrderedDict[Hashable, _Producer] = OrderedDict()
        self._next = 0
        self._late = False

    def of(self, block: CsiBlock, producer: Hashable = None, content: int = 0) -> int | None:
        """The number of the block's first frame, or None for a duplicate.

        Parameters
        ----------
        block
            With the producer's own number.
        producer
            Who sent it: a name or a connection.
        content
            A checksum of what it sent.
        """
        known = self._producers.setdefault(producer, _Producer(block.seq))
        self._producers.move_to_end(producer)
        if len(self._producers) > REMEMBERED_PRODUCERS:
            self._producers.popitem(last=False)
        if known.is_duplicate(block.seq, content):
            return None
        ahead = block.seq - known.expected
        self._late = ahead < 0 and known.fills_gap(block.seq, block.seq + len(block))
        if self._late:
            return max(self._next + ahead, 0)
        if ahead < 0 or ahead > LONGEST_GAP:
            self.restarts += 1
            known.begin_anew(block.seq)
            ahead = 0
        if ahead:
            known.open_gap(block.seq)
        known.expected = block.seq + len(block)
        number = self._next + ahead
        self._next = number + len(block)
        return number

    def leave_out(self, frames: int) -> None:
        """Give no numbers to the last `frames` frames of the block before."""
        if not self._late:
            self._next -= frames
