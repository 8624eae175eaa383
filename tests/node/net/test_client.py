from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zmq

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.net.client import Subscription, subscribe
from chachart.node.net.wire import chart_topic, encode_chart, encode_report

MakeUpdate = Callable[..., ChartUpdate]
PATIENCE_S = 20.0


class Publisher:
    """The far end of a subscription, with the sequence number of each message in the test's hand."""

    def __init__(self, endpoint: str) -> None:
        # A context of its own, whose end waits until the endpoint is free again.
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.XPUB)
        self.socket.linger = 0
        self.socket.bind(endpoint)

    def wait(self) -> None:
        """Until all three topics of a subscriber are known here."""
        for _ in range(3):
            assert self.socket.poll(1000 * PATIENCE_S)
            self.socket.recv()

    def close(self) -> None:
        self.socket.close()
        self.context.term()

    def send(self, seq: int, update: ChartUpdate) -> None:
        self.socket.send_multipart([chart_topic(update.array), encode_chart(update, seq)])


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"ipc://{tmp_path}/charts"


@pytest.fixture
def publisher(endpoint: str) -> Iterator[Publisher]:
    made = Publisher(endpoint)
    yield made
    made.close()


def receive(charts: Subscription) -> ChartUpdate:
    update = charts.recv(PATIENCE_S)
    assert update is not None
    return update


def test_what_was_published_arrives(endpoint: str, publisher: Publisher, make_update: MakeUpdate) -> None:
    with subscribe(endpoint) as charts:
        publisher.wait()
        sent = make_update([3, 1, 2**63])
        publisher.send(0, sent)
        update = next(iter(charts))
    np.testing.assert_array_equal(update.ue, sent.ue)
    np.testing.assert_array_equal(update.theta, sent.theta)
    assert update.method == sent.method


def test_gaps_are_told_by_topic(endpoint: str, publisher: Publisher, make_update: MakeUpdate) -> None:
    with subscribe(endpoint) as charts:
        publisher.wait()
        sent = [(5, "lab"), (6, "lab"), (9, "lab"), (100, "roof"), (10, "lab"), (102, "roof")]
        gaps = []
        for seq, array in sent:
            publisher.send(seq, make_update([1], array))
            assert receive(charts).array == array
            gaps.append(charts.gap)
        assert gaps == [0, 0, 2, 0, 0, 1]
        assert (charts.lost, charts.restarts) == (3, 0)
        publisher.send(0, make_update([1]))
        receive(charts)
        assert (charts.gap, charts.lost, charts.restarts) == (0, 3, 1)


def test_an_array_whose_name_begins_alike_is_another(
    endpoint: str, publisher: Publisher, make_update: MakeUpdate
) -> None:
    with subscribe(endpoint, "lab") as charts:
        publisher.wait()
        publisher.send(0, make_update([1], "lab2"))
        publisher.send(0, make_update([2], "lab"))
        assert receive(charts).array == "lab"


def test_reports_are_kept(endpoint: str, publisher: Publisher, make_update: MakeUpdate) -> None:
    with subscribe(endpoint, "lab") as charts:
        publisher.wait()
        for kind, values in (("quality", {"tw": 0.5}), ("status", {"frames_in": 7})):
            publisher.socket.send_multipart(
                [f"{kind}.lab".encode(), encode_report(kind, "lab", 0, 1, values)]
            )
        publisher.send(0, make_update([1]))
        receive(charts)
        assert charts.quality is not None
        assert charts.quality["tw"] == 0.5
        assert charts.status is not None
        assert charts.status["frames_in"] == 7


def test_messages_that_are_not_the_protocol_are_counted(
    endpoint: str, publisher: Publisher, make_update: MakeUpdate
) -> None:
    with subscribe(endpoint) as charts:
        publisher.wait()
        publisher.socket.send_multipart([b"chart.lab"])
        publisher.socket.send_multipart([b"chart.lab", b"\xc1"])
        publisher.socket.send_multipart([b"quality.lab", encode_report("status", "lab", 0, 1, {})])
        publisher.send(0, make_update([1]))
        receive(charts)
        assert charts.rejected.as_dict() == {"parts": 1, "header": 1, "type": 1}


def test_the_node_goes_and_comes_back(endpoint: str, make_update: MakeUpdate) -> None:
    with subscribe(endpoint) as charts:
        for run in range(3):
            publisher = Publisher(endpoint)
            try:
                # ZeroMQ subscribes anew from within the subscriber's own calls.
                deadline = time.monotonic() + PATIENCE_S
                while not publisher.socket.poll(0) and time.monotonic() < deadline:
                    assert charts.recv(0.02) is None
                publisher.wait()
                publisher.send(7 - run, make_update([run]))
                assert receive(charts).ue.tolist() == [run]
            finally:
                publisher.close()
        assert charts.restarts == 2


def test_silence(endpoint: str, publisher: Publisher) -> None:
    with subscribe(endpoint, timeout=0.01) as charts:
        assert charts.recv(0.01) is None
        with pytest.raises(TimeoutError, match=r"no chart from ipc.* for 0.01 s"):
            next(iter(charts))


def test_a_flood_of_reports_does_not_outlast_the_timeout(endpoint: str, publisher: Publisher) -> None:
    with subscribe(endpoint, queue=100_000) as charts:
        publisher.wait()
        for n in range(1000):
            publisher.socket.send_multipart([b"status.lab", encode_report("status", "lab", n, 1, {})])
        deadline = time.monotonic() + PATIENCE_S
        while charts.status is None and time.monotonic() < deadline:
            assert charts.recv(0.0) is None
        assert charts.status is not None


@pytest.mark.parametrize("wrong", ["here", "tcp://127.0.0.1", "xyz://a:1", ""])
def test_no_endpoint(wrong: str) -> None:
    with pytest.raises(SetupError, match="no endpoint to subscribe to"):
        subscribe(wrong)
