from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq
from csi_samples import START_NS, assert_same_frames, small_array, some_block
from hypothesis import given, settings
from hypothesis import strategies as st
from node_runs import until
from source_contract import SourceCase, SourceContract, receive

from chachart.node.data.csi import CsiBlock
from chachart.node.net.wire import encode_csi
from chachart.sources.base import Source
from chachart.sources.numbering import Numbering
from chachart.sources.zmq import ZmqSettings, ZmqSource

MS = 1_000_000


class Producer:
    """Somebody else's program: a PUSH socket that sends protocol 1."""

    def __init__(self, endpoint: str) -> None:
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.PUSH)
        self.socket.connect(endpoint)
        self.seq = 0

    def send(self, block: CsiBlock) -> None:
        self.socket.send_multipart(encode_csi(block))

    def next_block(self, frames: int = 4) -> CsiBlock:
        block = some_block(frames, seq=self.seq, start_ns=START_NS + self.seq * MS, step_ns=MS)
        self.seq += frames
        return block

    def close(self) -> None:
        self.context.destroy(linger=0)


def numbers(blocks: list[CsiBlock]) -> list[int]:
    """The number of each frame."""
    return [block.seq + row for block in blocks for row in range(len(block))]


@pytest.fixture
def source(tmp_path: Path) -> Iterator[ZmqSource]:
    with ZmqSource(ZmqSettings(endpoint=f"ipc://{tmp_path}/csi"), small_array()) as source:
        yield source


@pytest.fixture
def producer(source: ZmqSource) -> Iterator[Producer]:
    producer = Producer(source.details()["endpoint"])
    yield producer
    producer.close()


class TestContract(SourceContract):
    @pytest.fixture
    def case(self) -> Iterator[SourceCase]:
        producers: dict[str, Producer] = {}

        def feed(source: Source) -> None:
            endpoint = source.details()["endpoint"]
            if endpoint not in producers:
                producers[endpoint] = Producer(endpoint)
            producers[endpoint].send(producers[endpoint].next_block())

        yield SourceCase(
            "zmq",
            {"endpoint": "tcp://127.0.0.1:0"},
            small_array(),
            feed,
            lambda source: {"endpoint": source.details()["endpoint"]},
        )
        for producer in producers.values():
            producer.close()


def test_blocks_come_as_they_were_sent(source: ZmqSource, producer: Producer) -> None:
    sent = [producer.next_block(n) for n in (1, 64, 7)]
    for block in sent:
        producer.send(block)
    assert_same_frames(receive(source, 72), sent)
    assert source.rejected.as_dict() == {}


def test_frames_that_came_one_by_one_are_handed_on_together(source: ZmqSource, producer: Producer) -> None:
    sent = [producer.next_block(1) for _ in range(70)]
    for block in [*sent[:40], *sent[50:]]:
        producer.send(block)
    received = receive(source, 60)
    assert_same_frames(received, [*sent[:40], *sent[50:]])
    assert len(received) < 60
    assert numbers(received) == [*range(40), *range(50, 70)]


def test_integer_samples_are_scaled(source: ZmqSource, producer: Producer) -> None:
    iq = np.random.default_rng(1).integers(-2000, 2000, (2, 4, 3, 2), np.int16)
    header = {
        "v": 1, "type": "csi", "array": "lab", "seq": 0, "shape": [2, 4, 3], "dtype": "<i2", "scale": 0.5,
        "ue": np.array([5, 6], "<u8").tobytes(), "time_ns": np.array([1, 2], "<i8").tobytes(),
    }  # fmt: skip
    producer.socket.send_multipart([msgpack.packb(header), iq.tobytes()])
    [block] = receive(source, 2)
    np.testing.assert_allclose(block.csi, (iq[..., 0] + 1j * iq[..., 1]) * 0.5)


def test_what_is_no_block_of_this_array_is_counted_by_reason(source: ZmqSource, producer: Producer) -> None:
    good = producer.next_block()
    header, csi = encode_csi(good)
    future = {**msgpack.unpackb(header), "v": 2}
    for message in (
        [b"hello"],
        [header],
        [header, csi, b""],
        [msgpack.packb(future), csi],
        [header, bytes(csi)[:-1]],
        [b"", b""],
        encode_csi(replace(good, array="roof")),
        encode_csi(some_block(antennas=8)),
    ):
        producer.socket.send_multipart(message)
    producer.send(good)
    assert_same_frames(receive(source, 4), good)
    assert source.rejected.as_dict() == {
        "parts": 3, "version": 1, "size": 1, "header": 1, "array": 1, "shape": 1
    }  # fmt: skip


def test_a_bad_frame_costs_no_neighbour(source: ZmqSource, producer: Producer) -> None:
    first, second = producer.next_block(), producer.next_block()
    first.csi[2, 1, 1] = np.inf
    producer.send(first)
    producer.send(second)
    received = receive(source, 7)
    assert_same_frames(received, [first.take(np.array([0, 1, 3])), second])
    assert numbers(received) == list(range(7))
    assert source.rejected.as_dict() == {"non_finite": 1}


def test_duplicates_are_counted_and_left_out(source: ZmqSource, producer: Producer) -> None:
    first, second = producer.next_block(), producer.next_block()
    for block in (first, first, second, first):
        producer.send(block)
    assert_same_frames(receive(source, 8), [first, second])
    assert source.recv(0.05) is None
    assert source.rejected.as_dict() == {"duplicate": 8}


def test_a_producer_that_starts_anew_goes_on(source: ZmqSource, producer: Producer) -> None:
    for _ in range(3):
        producer.send(producer.next_block())
    later = some_block(4, seq=0, start_ns=START_NS + 1000 * MS)
    producer.send(later)
    received = receive(source, 16)
    assert numbers(received) == list(range(16))
    assert source.details()["restarts"] == 1


def test_too_long_a_message_is_counted_and_costs_nobody_else(tmp_path: Path) -> None:
    settings = ZmqSettings(endpoint=f"ipc://{tmp_path}/csi", max_message_bytes=4096)
    with ZmqSource(settings, small_array()) as source:
        greedy, modest = Producer(f"ipc://{tmp_path}/csi"), Producer(f"ipc://{tmp_path}/csi")
        greedy.send(some_block(64))
        while not source.rejected.total():
            assert source.recv(1.0) is None
        modest.send(modest.next_block())
        assert_same_frames(receive(source, 4), some_block(4, start_ns=START_NS, step_ns=MS))
        assert source.rejected.as_dict() == {"too_long": 1}
        assert "max_message_bytes is 4096" in str(source.complaint)
        greedy.close()
        modest.close()


def test_so_long_a_message_that_it_ends_its_connection_is_counted(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/csi"
    with ZmqSource(ZmqSettings(endpoint=endpoint, max_message_bytes=4096), small_array()) as source:
        with zmq.Context() as context, context.socket(zmq.PUSH) as greedy:
            greedy.linger = 0
            greedy.connect(endpoint)
            greedy.send(bytes(10_000_000))
            while not source.rejected.total():
                assert source.recv(0.1) is None
        assert source.rejected.as_dict() == {"too_long": 1}
        assert "max_message_bytes is 4096" in str(source.complaint)
        modest = Producer(endpoint)
        modest.send(modest.next_block())
        assert_same_frames(receive(source, 4), some_block(4, start_ns=START_NS, step_ns=MS))
        modest.close()
        until(lambda: source.details()["producers"] == 0, "it has gone")
        source.recv(0.0)
        assert source.rejected.as_dict() == {"too_long": 1}, "who just goes is not counted"


def test_a_message_of_64_frames_of_a_large_array_fits(tmp_path: Path) -> None:
    array = small_array(64, 1024)
    frames = some_block(64, antennas=64, subcarriers=1024)
    with ZmqSource(ZmqSettings(endpoint=f"ipc://{tmp_path}/csi"), array) as source:
        producer = Producer(f"ipc://{tmp_path}/csi")
        producer.send(frames)
        assert sum(len(block) for block in receive(source, 64)) == 64
        producer.close()


@pytest.mark.parametrize("named", [True, False])
def test_producers_that_number_and_stamp_alike_lose_nothing(
    source: ZmqSource, tmp_path: Path, named: bool
) -> None:
    producers = [Producer(source.details()["endpoint"]) for _ in range(3)]
    rng = np.random.default_rng(3)
    blocks = [[some_block(4, seq=4 * n, start_ns=START_NS) for n in range(20)] for _ in producers]
    for n in range(20):
        for number, producer in enumerate(producers):
            block = blocks[number][n]
            block.csi[:] += rng.standard_normal(block.csi.shape) if named else 0
            header, csi = encode_csi(block)
            name = {"producer": f"host {number}"} if named else {}
            producer.socket.send_multipart([msgpack.packb({**msgpack.unpackb(header), **name}), csi])
    assert numbers(receive(source, 240)) == list(range(240))
    assert source.rejected.as_dict() == {}
    assert source.details()["restarts"] == 0
    for producer in producers:
        producer.close()


def test_a_named_producer_without_a_clock_may_start_again_and_again(source: ZmqSource) -> None:
    rng = np.random.default_rng(4)
    for _ in range(3):
        producer = Producer(source.details()["endpoint"])
        for n in range(10):
            block = some_block(4, seq=4 * n, start_ns=0)
            block.csi[:] = rng.standard_normal(block.csi.shape)
            header, csi = encode_csi(block)
            named = {**msgpack.unpackb(header), "producer": "roof"}
            producer.socket.send_multipart([msgpack.packb(named), csi])
        assert sum(len(block) for block in receive(source, 40)) == 40
        producer.close()
    assert source.rejected.as_dict() == {}
    assert source.details()["restarts"] == 2


def test_lossless_is_a_setting() -> None:
    assert not ZmqSource(ZmqSettings(), small_array()).lossless
    assert ZmqSource(ZmqSettings(lossless=True), small_array()).lossless


@given(
    gaps=st.lists(st.integers(0, 50), min_size=1, max_size=30),
    frames=st.integers(1, 64),
    bad=st.integers(0, 3),
    start=st.integers(0, 2**62),
)
@settings(deadline=None)
def test_gaps_stay_visible_and_unusable_frames_leave_none(
    gaps: list[int], frames: int, bad: int, start: int
) -> None:
    numbering = Numbering()
    seq, expected = start, 0
    for index, gap in enumerate(gaps):
        seq += gap if index else 0
        expected += gap if index else 0
        block = some_block(frames, seq=seq, start_ns=START_NS + index * 1000 * MS)
        assert numbering.of(block, content=index) == expected
        left_out = min(bad, frames)
        numbering.leave_out(left_out)
        seq += frames
        expected += frames - left_out
    assert numbering.restarts == 0


def test_a_late_block_keeps_its_place() -> None:
    numbering = Numbering()
    early, late, last = (some_block(5, seq=s, start_ns=START_NS + s * MS, step_ns=MS) for s in (0, 5, 10))
    assert [numbering.of(b) for b in (early, last, late)] == [0, 10, 5]
    assert numbering.restarts == 0
