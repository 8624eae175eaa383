from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zmq
from chart_samples import QUALITY, STATUS, StillNode, some_chart
from csi_samples import small_array
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sink_contract import SinkCase, SinkContract

from chachart.node.data.chart import ChartUpdate
from chachart.node.net.wire import decode_chart, decode_report
from chachart.sinks.publisher import ROWS_PER_MESSAGE, Publisher, PublisherSettings

DEADLINE_S = 20.0
Message = tuple[bytes, bytes]


class Subscriber:
    """Somebody else's program: a SUB socket."""

    def __init__(self, endpoint: str, *topics: bytes) -> None:
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.SUB)
        self.socket.connect(endpoint)
        for topic in topics:
            self.socket.subscribe(topic)

    def receive(self, n: int, publisher: Publisher) -> list[Message]:
        """The next `n` messages, while the publisher ticks."""
        messages: list[Message] = []
        deadline = time.monotonic() + DEADLINE_S
        while len(messages) < n:
            assert time.monotonic() < deadline, f"only {len(messages)} of {n} messages came"
            publisher.on_tick()
            if self.socket.poll(20):
                topic, body = self.socket.recv_multipart()
                messages.append((topic, body))
        return messages

    def nothing(self, publisher: Publisher) -> bool:
        """Whether what is sent from now on is the next that comes."""
        publisher.on_chart(some_chart(1, seed=99))
        [(_, body)] = self.receive(1, publisher)
        return decode_chart(body)[1].x.tolist() == some_chart(1, seed=99).x.tolist()

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(self, *error: object) -> None:
        self.context.destroy(linger=0)


@pytest.fixture
def publisher(tmp_path: Path) -> Iterator[Publisher]:
    publisher = Publisher(PublisherSettings(endpoint=f"ipc://{tmp_path}/chart"), small_array())
    publisher.open(StillNode(some_chart(20, seed=4), QUALITY))
    yield publisher
    publisher.close()


def where(publisher: Publisher) -> str:
    endpoint = publisher.where()
    assert endpoint is not None
    return endpoint


def assert_same_chart(a: ChartUpdate, b: ChartUpdate) -> None:
    assert a.method == b.method
    for name in ("ue", "time_ns", "theta", "rho", "theta_std", "x", "y", "snr", "snapshots", "position"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


class TestContract(SinkContract):
    @pytest.fixture
    def case(self) -> SinkCase:
        return SinkCase(
            "publisher",
            {"endpoint": "tcp://127.0.0.1:0"},
            small_array(),
            impossible={"endpoint": "tcp://192.0.2.1:5556"},
            taken=lambda sink: {"endpoint": sink.where()},
        )


def test_a_new_subscriber_first_gets_the_whole_chart(publisher: Publisher) -> None:
    with Subscriber(where(publisher), b"chart.lab") as early:
        [(topic, body)] = early.receive(1, publisher)
        assert topic == b"chart.lab"
        seq, chart = decode_chart(body)
        assert seq == 0
        assert_same_chart(chart, some_chart(20, seed=4))
        publisher.on_chart(some_chart(3))
        [(_, body)] = early.receive(1, publisher)
        assert_same_chart(decode_chart(body)[1], some_chart(3))
        with Subscriber(where(publisher), b"chart.lab") as late:
            seq, chart = decode_chart(late.receive(1, publisher)[0][1])
        assert seq == 1
        assert_same_chart(chart, some_chart(20, seed=4))
        [(_, body)] = early.receive(1, publisher)
        assert decode_chart(body)[0] == 2, "what came while the whole chart was kept comes again, to be sure"
        assert early.nothing(publisher), "the whole chart was for the other one alone"


def test_each_topic_has_its_own_numbers(publisher: Publisher) -> None:
    with Subscriber(where(publisher), b"") as subscriber:
        first = dict(subscriber.receive(3, publisher))
        assert decode_report("quality", first[b"quality.lab"])["tw"] == QUALITY["tw"]
        assert decode_report("status", first[b"status.lab"])["dropped"] == STATUS["dropped"]
        publisher.on_quality({"tw": 0.5})
        publisher.on_status({"frames_in": 11})
        publisher.on_status({"frames_in": 12})
        (_, quality), (_, status), (_, later) = subscriber.receive(3, publisher)
    assert decode_report("quality", quality)["seq"] == 1
    assert [decode_report("status", s)["seq"] for s in (status, later)] == [1, 2]
    assert decode_report("status", later)["frames_in"] == 12


def test_whoever_wants_quality_gets_no_chart(publisher: Publisher) -> None:
    with Subscriber(where(publisher), b"quality.") as subscriber:
        assert subscriber.receive(1, publisher)[0][0] == b"quality.lab"
        publisher.on_chart(some_chart())
        publisher.on_quality({"tw": 1.0})
        assert subscriber.receive(1, publisher)[0][0] == b"quality.lab"


def test_a_long_chart_comes_in_several_messages(publisher: Publisher) -> None:
    with Subscriber(where(publisher), b"chart.lab") as subscriber:
        subscriber.receive(1, publisher)
        chart = some_chart(2 * ROWS_PER_MESSAGE + 10)
        publisher.on_chart(chart)
        messages = [decode_chart(body) for _, body in subscriber.receive(3, publisher)]
    assert [seq for seq, _ in messages] == [1, 2, 3]
    assert_same_chart(ChartUpdate.concatenate([part for _, part in messages]), chart)


def test_a_slow_subscriber_sees_what_it_lost(tmp_path: Path) -> None:
    settings = PublisherSettings(endpoint=f"ipc://{tmp_path}/chart", queue_messages=16)
    publisher = Publisher(settings, small_array())
    publisher.open(StillNode(some_chart()))
    try:
        with Subscriber(where(publisher)) as slow:
            slow.socket.rcvhwm = 1
            slow.socket.subscribe(b"chart.lab")
            slow.receive(1, publisher)
            big = some_chart(ROWS_PER_MESSAGE)
            for _ in range(100):
                publisher.on_chart(big)
            seqs = [decode_chart(body)[0] for _, body in slow.receive(5, publisher)]
            while slow.socket.poll(50):
                slow.socket.recv_multipart()
            publisher.on_chart(some_chart())
            last = decode_chart(slow.receive(1, publisher)[0][1])[0]
        assert seqs == sorted(seqs)
        assert last == 101
    finally:
        publisher.close()


@given(messages=st.lists(st.lists(st.binary(max_size=40), min_size=1, max_size=3), max_size=5))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_nothing_that_a_subscriber_sends_disturbs(publisher: Publisher, messages: list[list[bytes]]) -> None:
    """An XSUB socket can send anything; after it, a plain subscriber is served as ever."""
    context = zmq.Context()
    rude = context.socket(zmq.XSUB)
    rude.connect(where(publisher))
    for message in messages:
        rude.send_multipart(message)
    with Subscriber(where(publisher), b"quality.lab") as subscriber:
        assert subscriber.receive(1, publisher)[0][0] == b"quality.lab"
    context.destroy(linger=0)


def test_an_ipc_endpoint_is_not_taken_away(publisher: Publisher) -> None:
    [problem] = Publisher.problems(PublisherSettings(endpoint=where(publisher)))
    assert "in use" in problem
    with Subscriber(where(publisher), b"chart.lab") as subscriber:
        assert subscriber.receive(1, publisher)
