from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.runtime.entries import Entry
from chachart.node.runtime.partition import ShardBlock
from chachart.node.runtime.shard_queue import MAX_DEATHS, READ_AGAIN_BYTES, ShardQueue

METHOD = ("bartlett", "bartlett")


def shard_block(frames: int = 1, number: int = 0) -> ShardBlock:
    ue, time_ns = np.zeros(frames, np.uint64), np.full(frames, number)
    block = CsiBlock("lab", number, ue, time_ns, np.zeros((frames, 1, 1), np.complex64))
    return ShardBlock(0, block, (), number, number + frames)


def numbers(entries: list[Entry]) -> list[int]:
    return [entry.content.block.seq for entry in entries]


def take_all(queue: ShardQueue) -> list[Entry]:
    return list(iter(lambda: queue.next_to_send(METHOD), None))


def test_credit_bounds_what_a_worker_holds() -> None:
    queue = ShardQueue(capacity=8, credit=2, lossless=True)
    for n in range(5):
        queue.put(shard_block(number=n))
    sent = take_all(queue)
    assert numbers(sent) == [0, 1]
    assert queue.acknowledge([0], 1, {}) == [sent[0].content]
    assert numbers(take_all(queue)) == [2]


def test_live_queue_drops_its_oldest() -> None:
    queue = ShardQueue(capacity=2, credit=1, lossless=False)
    for n in range(4):
        queue.put(shard_block(3, n))
    assert queue.dropped.as_dict() == {"queue_full": 6}
    assert numbers(take_all(queue)) == [2]


def arriving(number: int, now: float, frames: int = 1) -> ShardBlock:
    return replace(shard_block(frames, number), arrivals=((now, frames),))


def test_an_idle_worker_gets_what_is_there_at_once() -> None:
    queue = ShardQueue(capacity=8, credit=8, lossless=True, block_frames=64, linger_s=1.0)
    for n in range(3):
        queue.put(arriving(n, now=0.0))
    assert queue.deadline() is None
    [entry] = take_all(queue)
    assert (len(entry.content.block), entry.content.start, entry.content.end) == (3, 0, 3)


def test_what_a_busy_worker_does_not_need_yet_grows_until_it_is_whole_or_has_waited() -> None:
    queue = ShardQueue(capacity=8, credit=8, lossless=True, block_frames=4, linger_s=1.0)
    queue.put(arriving(0, now=0.0))
    take_all(queue)
    assert queue.put(arriving(1, now=5.0))
    assert not queue.put(arriving(2, now=5.5))
    assert queue.next_to_send(METHOD, now=5.9) is None
    assert queue.deadline() == 6.0
    waited = queue.next_to_send(METHOD, now=6.0)
    assert waited is not None
    assert len(waited.content.block) == 2
    assert queue.put(arriving(3, now=6.0, frames=3))
    assert queue.put(arriving(6, now=6.0)), "it is whole"
    whole = queue.next_to_send(METHOD, now=6.0)
    assert whole is not None
    assert len(whole.content.block) == 4


def test_blocks_of_two_arrays_are_not_joined() -> None:
    queue = ShardQueue(capacity=8, credit=8, lossless=True, block_frames=64, linger_s=1.0)
    there = arriving(0, now=0.0)
    queue.put(there)
    queue.put(replace(there, block=replace(there.block, array="roof"), start=1, end=2))
    assert [entry.content.block.array for entry in take_all(queue)] == ["lab"]
    assert queue.deadline() == 1.0


def test_a_full_live_queue_drops_the_block_that_has_grown() -> None:
    queue = ShardQueue(capacity=2, credit=1, lossless=False, block_frames=2)
    for n in range(5):
        queue.put(arriving(n, now=0.0))
    assert queue.dropped.as_dict() == {"queue_full": 2}
    assert (queue.frames_held, queue.unsent_from) == (3, 2)


def estimate(queue: ShardQueue, entries: list[Entry]) -> int:
    """Acknowledge blocks all of whose frames were estimated; how many frames."""
    frames = sum(len(entry.content.block) for entry in entries)
    queue.acknowledge([entry.seq for entry in entries], frames, {})
    return frames


@pytest.mark.parametrize("lossless", [True, False])
def test_what_a_dead_worker_held_goes_to_its_successor_with_the_same_numbers(lossless: bool) -> None:
    queue = ShardQueue(capacity=8, credit=4, lossless=lossless)
    for n in range(6):
        queue.put(shard_block(number=n))
    first = take_all(queue)
    estimate(queue, first[:1])
    assert queue.worker_lost() == 3
    queue.worker_up(0, 1, {}, ues=1)
    again = take_all(queue)
    assert numbers(again) == [1, 2, 3, 4]
    assert [entry.seq for entry in again] == [1, 2, 3, 4]
    assert (queue.frames_replayed, queue.state_lost) == (3, 0)


def test_a_successor_gets_what_its_state_lacks_and_its_frames_do_not_count_twice() -> None:
    queue = ShardQueue(capacity=8, credit=8, lossless=True, retain_bytes=10_000)
    for n in range(5):
        queue.put(shard_block(2, n))
    sent = take_all(queue)
    estimate(queue, sent[:4])
    queue.cover(1)
    queue.worker_lost()
    handover = queue.worker_up(1, 4, {}, ues=1)
    assert (handover.lost, handover.ahead) == (0, False)
    assert queue.replaying
    again = take_all(queue)
    assert [entry.seq for entry in again] == [2, 3, 4]
    for entry in again:
        estimate(queue, [entry])
    assert not queue.replaying
    assert (queue.frames_estimated, queue.frames_held, queue.state_lost) == (10, 0, 0)


def test_a_snapshot_of_which_nobody_heard_counts_what_is_in_it() -> None:
    queue = ShardQueue(capacity=8, credit=8, lossless=True, retain_bytes=10_000)
    for n in range(3):
        queue.put(shard_block(2, n))
    estimate(queue, take_all(queue)[:1])
    queue.worker_lost()
    handover = queue.worker_up(1, 3, {"zero": 1}, ues=1)
    assert (handover.lost, handover.ahead) == (0, True)
    assert [entry.seq for entry in take_all(queue)] == [2]
    assert (queue.frames_estimated, queue.rejected.as_dict(), queue.frames_held) == (3, {"zero": 1}, 2)


def test_what_is_beyond_the_bound_is_counted_as_lost_state() -> None:
    size = shard_block(2).block.csi.nbytes
    queue = ShardQueue(capacity=8, credit=8, lossless=False, retain_bytes=2 * size)
    for n in range(6):
        queue.put(shard_block(2, n))
    estimate(queue, take_all(queue))
    queue.worker_lost()
    assert queue.worker_up(-1, 0, {}, ues=7).lost == 8
    assert [entry.seq for entry in take_all(queue)] == [4, 5]
    assert (queue.state_lost, queue.ues_reset, queue.frames_estimated) == (8, 1, 12)


def test_a_lossless_queue_waits_for_a_snapshot_unless_there_can_be_none() -> None:
    size = shard_block(2).block.csi.nbytes
    queue = ShardQueue(capacity=8, credit=8, lossless=True, retain_bytes=2 * size)
    for n in range(2):
        queue.put(shard_block(2, n))
    estimate(queue, take_all(queue))
    assert queue.half_retained
    assert queue.full
    queue.cover(0)
    assert not queue.full
    queue.put(shard_block(2, 2))
    estimate(queue, take_all(queue))
    queue.can_snapshot = False
    assert not queue.full


def test_nothing_waits_for_a_snapshot_where_the_source_can_be_read_again() -> None:
    size = shard_block(2).block.csi.nbytes
    queue = ShardQueue(capacity=8, credit=8, lossless=True, retain_bytes=2 * size)
    queue.can_read_again = True
    for n in range(4):
        queue.put(shard_block(2, n))
        estimate(queue, take_all(queue))
        assert not queue.full
        assert not queue.half_retained
    assert queue.worker_up(-1, 0, {}, ues=1).lost == 4


def test_little_is_retained_of_what_can_be_read_again() -> None:
    ue, csi = np.zeros(8, np.uint64), np.zeros((8, 64, 1024), np.complex64)
    queue = ShardQueue(capacity=99, credit=99, lossless=True, retain_bytes=100 * csi.nbytes)
    queue.can_read_again = True
    for n in range(8):
        queue.put(ShardBlock(0, CsiBlock("lab", n, ue, np.zeros(8, np.int64), csi), (), n, n + 1))
        estimate(queue, take_all(queue))
    assert 0 < queue.retained_bytes <= READ_AGAIN_BYTES < 8 * csi.nbytes


def test_a_new_queue_goes_on_counting_where_the_worker_is() -> None:
    queue = ShardQueue(capacity=8, credit=8, lossless=True, retain_bytes=10_000)
    assert queue.worker_up(41, 80, {"zero": 4}, ues=3).lost == 0
    queue.put(shard_block())
    assert [entry.seq for entry in take_all(queue)] == [42]
    assert (queue.frames_estimated, queue.rejected.as_dict()) == (80, {"zero": 4})
    queue.worker_lost()
    assert queue.worker_up(20, 40, {}, ues=3).lost == 44
    assert queue.ues_reset == 3


def test_a_block_that_kills_its_workers_is_dropped() -> None:
    queue = ShardQueue(capacity=8, credit=2, lossless=True)
    for n in range(3):
        queue.put(shard_block(5, n))
    for _ in range(MAX_DEATHS):
        assert numbers(take_all(queue))[0] == 0
        queue.worker_lost()
        queue.worker_up(-1, 0, {}, ues=0)
    assert queue.dropped.as_dict() == {"worker_killer": 5}
    assert numbers(take_all(queue)) == [1, 2]


@pytest.mark.parametrize("lossless", [True, False])
def test_late_and_repeated_acknowledgements_do_not_count(lossless: bool) -> None:
    queue = ShardQueue(capacity=8, credit=2, lossless=lossless)
    queue.put(shard_block())
    [entry] = take_all(queue)
    queue.worker_lost()
    assert queue.acknowledge([entry.seq], 1, {}) == []
    assert queue.frames_estimated == 0


@dataclass(frozen=True)
class State:
    """What a worker knows."""

    applied: int = -1
    estimated: int = 0
    rejected: dict[str, int] = field(default_factory=dict)

    def with_blocks(self, entries: list[Entry], estimated: int, rejected: dict[str, int]) -> State:
        assert entries[0].seq > self.applied, "nothing is applied twice"
        counts = Counters()
        counts.merge(self.rejected)
        counts.merge(rejected)
        return State(entries[-1].seq, self.estimated + estimated, counts.as_dict())


class QueueMachine(RuleBasedStateMachine):
    """Whatever happens, every frame that was put is estimated, dropped or held, and no other."""

    @initialize(
        lossless=st.booleans(), retain_bytes=st.sampled_from([0, 100, 10_000]), block_frames=st.integers(1, 9)
    )
    def start(self, lossless: bool, retain_bytes: int, block_frames: int) -> None:
        self.lossless = lossless
        self.queue = ShardQueue(4, 3, lossless, retain_bytes, block_frames)
        self.frames = 0
        self.state = State()
        self.snapshots = [State()]
        self.sent: list[Entry] = []

    @rule(frames=st.integers(1, 9))
    def put(self, frames: int) -> None:
        if not (self.lossless and self.queue.full):
            self.queue.put(shard_block(frames))
            self.frames += frames

    @rule()
    def send(self) -> None:
        if (entry := self.queue.next_to_send(METHOD)) is not None:
            self.sent.append(entry)

    @precondition(lambda self: self.sent)
    @rule(blocks=st.integers(1, 3), rejected=st.booleans())
    def acknowledge(self, blocks: int, rejected: bool) -> None:
        entries, self.sent = self.sent[:blocks], self.sent[blocks:]
        if len({entry.acknowledged for entry in entries}) > 1:
            entries, self.sent = entries[:1], entries[1:] + self.sent
        frames = sum(len(entry.content.block) for entry in entries)
        estimated, lost = (0, {"not_finite": frames}) if rejected else (frames, {})
        self.state = self.state.with_blocks(entries, estimated, lost)
        self.queue.acknowledge([entry.seq for entry in entries], estimated, lost)

    @precondition(lambda self: not self.queue.replaying)
    @rule(heard=st.booleans())
    def snapshot(self, heard: bool) -> None:
        self.snapshots.append(self.state)
        if heard:
            self.queue.cover(self.state.applied)

    @rule()
    def lose(self) -> None:
        self.queue.worker_lost()
        self.sent.clear()
        self.state = self.snapshots[-1]
        lost = self.queue.worker_up(self.state.applied, self.state.estimated, self.state.rejected, ues=1).lost
        self.state = replace(self.state, estimated=self.state.estimated + lost)

    @invariant()
    def counts_add_up(self) -> None:
        queue = self.queue
        gone = queue.rejected.total() + queue.dropped.total()
        assert self.frames == queue.frames_estimated + gone + queue.frames_held
        if self.lossless:
            assert set(queue.dropped.as_dict()) <= {"worker_killer"}

    @invariant()
    def only_bounds_lose_state(self) -> None:
        if self.queue._retain_bytes == 10_000:
            assert self.queue.state_lost == 0 or self.queue.dropped.total()

    def teardown(self) -> None:
        if hasattr(self, "queue"):
            self.queue.abandon("drain_deadline")
            assert self.queue.blocks_held == self.queue.frames_held == 0
            gone = self.queue.rejected.total() + self.queue.dropped.total()
            assert self.frames == self.queue.frames_estimated + gone


TestQueueMachine = QueueMachine.TestCase
TestQueueMachine.settings = settings(max_examples=50, stateful_step_count=30, deadline=None)
