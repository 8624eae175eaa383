from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from chachart.node.data.csi import CsiBlock
from chachart.node.runtime.partition import ShardBlock
from chachart.node.runtime.shard_queue import MAX_DEATHS, Entry, ShardQueue

METHOD = ("bartlett", "bartlett")


def shard_block(frames: int = 1, number: int = 0) -> ShardBlock:
    ue, time_ns = np.zeros(frames, np.uint64), np.full(frames, number)
    return ShardBlock(0, CsiBlock("lab", number, ue, time_ns, np.zeros((frames, 1, 1), np.complex64)), ())


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


def test_lossless_queue_replays_in_order_with_the_same_numbers() -> None:
    queue = ShardQueue(capacity=8, credit=4, lossless=True)
    for n in range(6):
        queue.put(shard_block(number=n))
    first = take_all(queue)
    queue.acknowledge([first[0].seq], 1, {})
    assert queue.worker_lost() == 3
    again = take_all(queue)
    assert numbers(again) == [1, 2, 3, 4]
    assert [entry.seq for entry in again] == [1, 2, 3, 4]
    assert queue.frames_replayed == 3


def test_live_queue_counts_what_a_dead_worker_held() -> None:
    queue = ShardQueue(capacity=8, credit=2, lossless=False)
    for n in range(3):
        queue.put(shard_block(5, n))
    take_all(queue)
    assert queue.worker_lost() == 0
    assert queue.dropped.as_dict() == {"worker_lost": 10}
    assert numbers(take_all(queue)) == [2]


def test_a_block_that_kills_its_workers_is_dropped() -> None:
    queue = ShardQueue(capacity=8, credit=2, lossless=True)
    for n in range(3):
        queue.put(shard_block(5, n))
    for _ in range(MAX_DEATHS):
        assert numbers(take_all(queue))[0] == 0
        queue.worker_lost()
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


class QueueMachine(RuleBasedStateMachine):
    """Whatever happens, every frame that was put is estimated, dropped or held, and no other."""

    @initialize(lossless=st.booleans())
    def start(self, lossless: bool) -> None:
        self.lossless = lossless
        self.queue = ShardQueue(capacity=4, credit=3, lossless=lossless)
        self.frames = 0
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
        frames = sum(len(entry.content.block) for entry in entries)
        seqs = [entry.seq for entry in entries]
        self.queue.acknowledge(seqs, 0 if rejected else frames, {"not_finite": frames} if rejected else {})

    @rule()
    def lose(self) -> None:
        self.queue.worker_lost()
        self.sent.clear()

    @invariant()
    def counts_add_up(self) -> None:
        queue = self.queue
        assert self.frames == queue.frames_estimated + queue.dropped.total() + queue.frames_held
        if self.lossless:
            assert set(queue.dropped.as_dict()) <= {"not_finite", "worker_killer"}

    def teardown(self) -> None:
        if hasattr(self, "queue"):
            self.queue.abandon("drain_deadline")
            assert self.queue.blocks_held == self.queue.frames_held == 0
            assert self.frames == self.queue.frames_estimated + self.queue.dropped.total()


TestQueueMachine = QueueMachine.TestCase
TestQueueMachine.settings = settings(max_examples=50, stateful_step_count=30, deadline=None)
