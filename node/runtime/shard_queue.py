"""What waits for one worker, what it holds, and what its successor would need. Pure: no sockets, no threads.

The promises of the node are kept here. A *live* shard drops its oldest waiting block when the queue is full,
a *lossless* one is full until a block is taken. What a dead worker held goes to its successor, and so does
what it had acknowledged since the last snapshot of its state: such blocks are retained, within bounds. At any
time: frames put = estimated + rejected + dropped + held.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence

from chachart.node.data.counters import Counters
from chachart.node.runtime.entries import Entry, Handover, Waiting
from chachart.node.runtime.partition import ShardBlock

MAX_DEATHS = 3
"""A block whose worker died so often while it was first in line is dropped, not sent again."""
READ_AGAIN_BYTES = 16 * 1024 * 1024
"""More CSI is not retained of what can be read again: it stays in the cache, and out of memory."""
LEARN = 0.1
"""Weight of the newest block in the typical time that one takes."""


class ShardQueue:
    """The way of blocks to one worker.

    An idle worker gets what is there at once; what comes while it is busy grows to whole blocks.

    Parameters
    ----------
    capacity
        Blocks that may wait.
    credit
        Blocks that the worker may hold unacknowledged.
    lossless
        Whether to keep every block.
    retain_bytes
        CSI of acknowledged blocks that may be retained until a snapshot covers them.
    block_frames
        Frames that make a whole block.
    linger_s
        How long less than a whole block waits for a busy worker.

    Attributes
    ----------
    frames_held
        Frames that wait or are unacknowledged.
    frames_estimated, frames_replayed
        Frames since the start; `frames_replayed` went to a successor.
    rejected, dropped
        Frames that workers could not use, and those that did not get to one, by reason.
    state_lost, ues_reset
        Frames that successors could not be given again, and the UEs they were of.
    covered_seq
        The last block that is in a snapshot.
    retained_bytes
        CSI that is retained.
    can_read_again
        Whether the source can give again what is not retained: nothing waits for a snapshot then.
    can_snapshot
        False while snapshots cannot be written: nothing waits for one then.
    typical_s
        How long a block takes from being sent to its acknowledgement; None before the first.
    """

    def __init__(
        self,
        capacity: int,
        credit: int,
        lossless: bool,
        retain_bytes: int = 0,
        block_frames: int = 1,
        linger_s: float = 0.0,
    ) -> None:
        self._capacity = capacity
        self._credit = credit
        self._lossless = lossless
        self._retain_bytes = retain_bytes
        self._block_frames = block_frames
        self._linger_s = linger_s
        self._waiting: deque[Waiting] = deque()
        self._again: deque[Entry] = deque()
        self._unacknowledged: dict[int, Entry] = {}
        self._retained: deque[Entry] = deque()
        self._unretained_ues: set[int] = set()
        self._unretained_seq = -1
        self._next_seq = 0
        self.frames_held = 0
        self.frames_estimated = 0
        self.frames_replayed = 0
        self.rejected = Counters()
        self.dropped = Counters()
        self.state_lost = 0
        self.ues_reset = 0
        self.covered_seq = -1
        self.retained_bytes = 0
        self.can_read_again = False
        self.can_snapshot = retain_bytes > 0
        self.typical_s: float | None = None

    @property
    def full(self) -> bool:
        """Whether a lossless source must wait before the next `put`."""
        return (self._waits and self.retained_bytes >= self._retain_bytes) or len(
            self._waiting
        ) >= self._capacity

    @property
    def half_retained(self) -> bool:
        """Whether it is time for a snapshot, lest blocks have to go that are not in one."""
        return not self.can_read_again and self.retained_bytes > self._retain_bytes / 2

    @property
    def _waits(self) -> bool:
        """Whether blocks wait for a snapshot rather than being retained no longer."""
        return self._lossless and self.can_snapshot and not self.can_read_again

    @property
    def replaying(self) -> bool:
        """Whether the worker still lacks what its predecessor had."""
        return bool(self._again) or any(entry.acknowledged for entry in self._unacknowledged.values())

    @property
    def last_seq(self) -> int:
        """The last block that was sent."""
        return self._next_seq - 1

    @property
    def blocks_held(self) -> int:
        """Blocks that wait or are unacknowledged, those included that a successor gets again."""
        return len(self._waiting) + len(self._again) + len(self._unacknowledged)

    @property
    def unsent_from(self) -> int | None:
        """The reader's number of the first frame that waits, or None."""
        return self._waiting[0].parts[0].start if self._waiting else None

    def oldest_sent_at(self) -> float | None:
        """When the oldest block was sent that is not acknowledged, or None."""
        return next((entry.sent_at for entry in self._unacknowledged.values()), None)

    def put(self, content: ShardBlock) -> bool:
        """Add frames; whether that is news to whoever waits for blocks.

        A live queue that is full drops its oldest block and counts it as `queue_full`.
        """
        frames = len(content.block)
        self.frames_held += frames
        last = self._waiting[-1] if self._waiting else None
        if last and last.frames + frames <= self._block_frames and last.parts[-1].fits(content):
            last.parts.append(content)
            last.frames += frames
            return last.frames == self._block_frames
        if not self._lossless and len(self._waiting) >= self._capacity:
            self._drop(self._waiting.popleft().frames, "queue_full")
        self._waiting.append(Waiting([content], frames))
        return True

    def next_to_send(self, method: tuple[str, str], now: float = 0.0, round_: int = 0) -> Entry | None:
        """The next block for the worker, from now on unacknowledged; None without block or credit."""
        if len(self._unacknowledged) >= self._credit:
            return None
        if self._again:
            entry = self._again.popleft()
        elif self._waiting and now >= self._ripe_at():
            entry = Entry(ShardBlock.joined(self._waiting.popleft().parts))
            entry.seq, entry.method, entry.round = self._next_seq, method, round_
            self._next_seq += 1
        else:
            return None
        entry.sent_at = now
        self._unacknowledged[entry.seq] = entry
        return entry

    def deadline(self) -> float | None:
        """When `next_to_send` will have something to give though nothing happens until then, or None."""
        if not self._waiting or self._again or len(self._unacknowledged) >= self._credit:
            return None
        ripe_at = self._ripe_at()
        return ripe_at if ripe_at > -math.inf else None

    def _ripe_at(self) -> float:
        """From when on the first block that waits may go."""
        first = self._waiting[0]
        whole = len(self._waiting) > 1 or first.frames >= self._block_frames
        return first.since + self._linger_s if self._unacknowledged and not whole else -math.inf

    def acknowledge(
        self, seqs: Sequence[int], estimated: int, rejected: Mapping[str, int], now: float = 0.0
    ) -> list[ShardBlock]:
        """The worker is done with the blocks `seqs`; nothing happens if one is not (or no longer) its own.

        Gives the blocks that were not acknowledged before: only their frames are counted.
        """
        if any(seq not in self._unacknowledged for seq in seqs):
            return []
        entries = [self._unacknowledged.pop(seq) for seq in seqs]
        took = now - entries[0].sent_at
        self.typical_s = took if self.typical_s is None else self.typical_s + LEARN * (took - self.typical_s)
        new = [entry for entry in entries if not entry.acknowledged]
        if new:
            self.frames_estimated += estimated
            self.rejected.merge(rejected)
        for entry in new:
            entry.acknowledged = True
            self.frames_held -= len(entry.content.block)
            self._retain(entry)
        return [entry.content for entry in new]

    def cover(self, seq: int) -> None:
        """A snapshot has everything up to that block: what was retained for it may go."""
        self.covered_seq = max(self.covered_seq, seq)
        while self._retained and self._retained[0].seq <= seq:
            self.retained_bytes -= self._retained.popleft().content.block.csi.nbytes
        if self._unretained_seq <= seq:
            self._unretained_ues.clear()

    def worker_lost(self) -> int:
        """The worker is dead: gives how many frames that it had not acknowledged wait for its successor."""
        held = list(self._unacknowledged.values())
        self._unacknowledged.clear()
        if held:
            held[0].deaths += 1
            if held[0].deaths >= MAX_DEATHS:
                self._kill(held.pop(0))
        self._again.extendleft(reversed(held))
        frames = sum(len(entry.content.block) for entry in held if not entry.acknowledged)
        self.frames_replayed += frames
        return frames

    def worker_up(self, applied: int, estimated: int, rejected: Mapping[str, int], ues: int) -> Handover:
        """A worker has come up; it gets everything that followed what is in its state.

        Parameters
        ----------
        applied
            The last block that is in its state, -1 for none.
        estimated, rejected
            What became of all frames up to there.
        ues
            How many UEs its predecessor had.
        """
        acknowledged = self.frames_estimated + self.rejected.total()
        known = estimated + sum(rejected.values())
        ahead = [entry for entry in self._again if not entry.acknowledged and entry.seq <= applied]
        if ahead or self._next_seq == 0:
            # Its predecessor died before it could say so, or it was there before this queue: it knows.
            self.frames_held -= sum(len(entry.content.block) for entry in ahead)
            self.frames_estimated, self.rejected = estimated, Counters()
            self.rejected.merge(rejected)
            self._next_seq = max(self._next_seq, applied + 1)
            acknowledged = known
        behind = [entry for entry in self._retained if entry.seq > applied]
        unsent = [entry for entry in self._again if not entry.acknowledged and entry.seq > applied]
        self._again = deque(behind + unsent)
        again = sum(len(entry.content.block) for entry in behind)
        self.frames_replayed += again
        lost = acknowledged - known - again
        if lost:
            self.state_lost += lost
            self.ues_reset += len(self._unretained_ues) or ues
        self._unretained_ues.clear()
        return Handover(lost, bool(ahead))

    def abandon(self, reason: str) -> None:
        """Drop all that is held and count it."""
        for entry in [*self._unacknowledged.values(), *self._again]:
            if not entry.acknowledged:
                self._drop(len(entry.content.block), reason)
        for waiting in self._waiting:
            self._drop(waiting.frames, reason)
        self._unacknowledged.clear()
        self._again.clear()
        self._waiting.clear()

    def _retain(self, entry: Entry) -> None:
        if not self._retain_bytes:
            return
        limit = min(self._retain_bytes, READ_AGAIN_BYTES) if self.can_read_again else self._retain_bytes
        self._retained.append(entry)
        self.retained_bytes += entry.content.block.csi.nbytes
        while self.retained_bytes > limit and not self._waits:
            oldest = self._retained.popleft()
            self.retained_bytes -= oldest.content.block.csi.nbytes
            self._unretained_seq = oldest.seq
            if not self.can_read_again:
                self._unretained_ues.update(oldest.content.block.ue.tolist())

    def _kill(self, entry: Entry) -> None:
        """Never again send a block that kills workers."""
        if entry.acknowledged:
            self._retained.remove(entry)
            self.retained_bytes -= entry.content.block.csi.nbytes
            self._unretained_seq = max(self._unretained_seq, entry.seq)
            self._unretained_ues.update(entry.content.block.ue.tolist())
        else:
            self._drop(len(entry.content.block), "worker_killer")

    def _drop(self, frames: int, reason: str) -> None:
        self.frames_held -= frames
        self.dropped.add(reason, frames)
