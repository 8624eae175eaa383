"""A worker with the test at the other end of its socket."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from csi_samples import small_array, some_block

from chachart.node.data.csi import CsiBlock
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.net.wire import encode_csi
from chachart.node.runtime import messages
from chachart.node.runtime.worker import Worker

ARRAY = small_array(8, 4)
DEADLINE_MS = 30_000
METHOD = ("bartlett", "bartlett")


class Feeder:
    """The other end: sends what a dispatcher does, gives what the worker answers."""

    def __init__(self, folder: Path) -> None:
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.ROUTER)
        self.socket.bind(f"ipc://{folder}/workers")
        self.folder = folder
        self._identity = b""
        self._workers: list[threading.Thread] = []

    def start_worker(self) -> dict[str, Any]:
        """Start one; its hello."""
        settings = {
            "shard": 0,
            "count": 1,
            "array": ARRAY.as_dict(),
            "estimator": {"max_ues": 1000, "averaging": "mean"},
            "state": {"folder": str(self.folder), "durable": False},
            "several": None,
        }

        def run() -> None:
            socket = self.context.socket(zmq.DEALER)
            socket.connect(f"ipc://{self.folder}/workers")
            Worker(settings, socket).run()
            socket.close()

        self._workers.append(threading.Thread(target=run))
        self._workers[-1].start()
        hello, _ = self.answer(messages.HELLO)
        self.send(messages.CONFIGURE, {"live": False, "lost": 0, "rows": False})
        return hello

    def send(self, kind: bytes, values: dict[str, Any], *parts: Any) -> None:
        self.socket.send_multipart([self._identity, kind, messages.pack(values), *parts])

    def block(self, seq: int, block: CsiBlock, again: bool = False, method: Any = METHOD) -> None:
        mark = {"frame": block.seq, "position": {"frames": block.seq}}
        header: dict[str, Any] = {
            "seq": seq,
            "method": method,
            "round": 0,
            "again": again,
            "end": block.seq + len(block),
            "mark": mark,
        }
        self.send(messages.BLOCK, header, *encode_csi(block))

    def answer(self, kind: bytes) -> tuple[dict[str, Any], list[bytes]]:
        """The next message of that kind."""
        while True:
            assert self.socket.poll(DEADLINE_MS), kind
            self._identity, came, values, *parts = self.socket.recv_multipart()
            if came == kind:
                return messages.unpack(values), parts

    def close(self) -> None:
        self.send(messages.END, {})
        for worker in self._workers:
            worker.join(10.0)
        self.context.destroy(linger=0)


@pytest.fixture
def feeder(tmp_path: Path) -> Iterator[Feeder]:
    feeder = Feeder(tmp_path)
    yield feeder
    feeder.close()


def frames(seq: int = 0) -> CsiBlock:
    return some_block(6, seq=seq, antennas=8, subcarriers=4)


def test_a_block_is_acknowledged_with_its_result(feeder: Feeder) -> None:
    hello = feeder.start_worker()
    assert (hello["seq"], hello["applied"], hello["ues"]) == (-1, [], 0)
    feeder.block(0, frames())
    done, [update] = feeder.answer(messages.DONE)
    assert (done["seqs"], done["estimated"], done["dropped"]) == ([0], 6, {})
    expected = ChartEstimator(ARRAY, averaging="mean").update(frames())
    np.testing.assert_allclose(messages.unpack_update(update).theta, expected.theta, rtol=1e-6)


def test_a_block_that_comes_again_has_no_result(feeder: Feeder) -> None:
    feeder.start_worker()
    feeder.block(0, frames(), again=True)
    _, [update] = feeder.answer(messages.DONE)
    assert update == b""


def test_a_snapshot_is_taken_up_by_a_successor(feeder: Feeder) -> None:
    feeder.start_worker()
    feeder.block(0, frames())
    feeder.answer(messages.DONE)
    feeder.send(messages.SNAPSHOT, {"mark": {"frame": 6, "position": {"frames": 6}}})
    written, _ = feeder.answer(messages.SNAPSHOTTED)
    assert (written["seq"], written["error"]) == (0, None)
    feeder.send(messages.END, {})
    hello = feeder.start_worker()
    assert (hello["seq"], hello["applied"], hello["mark"]["frame"]) == (0, [[1, 0, 6]], 6)
    assert hello["totals"] == {"estimated": 6, "rejected": {}}
    feeder.send(messages.CONFIGURE, {"live": False, "lost": 0, "rows": True})
    _, [rows] = feeder.answer(messages.ROWS)
    assert sorted(messages.unpack_update(rows).ue.tolist()) == sorted(set(frames().ue.tolist()))
    feeder.block(1, frames(6))
    feeder.answer(messages.DONE)
    estimator = ChartEstimator(ARRAY, averaging="mean")
    estimator.update(frames())
    expected = estimator.update(frames(6))
    feeder.send(messages.CONFIGURE, {"live": False, "lost": 0, "rows": True})
    _, [rows] = feeder.answer(messages.ROWS)
    chart = messages.unpack_update(rows)
    chart = chart.take(np.isin(chart.ue, expected.ue))
    chart, expected = chart.take(np.argsort(chart.ue)), expected.take(np.argsort(expected.ue))
    np.testing.assert_allclose(chart.theta, expected.theta, rtol=1e-6)
    np.testing.assert_array_equal(chart.snapshots, expected.snapshots)


def test_a_snapshot_that_cannot_be_written_is_told(feeder: Feeder) -> None:
    feeder.start_worker()
    feeder.block(0, frames())
    feeder.answer(messages.DONE)
    (feeder.folder / "worker-0-of-1-00000001.snapshot.new").mkdir()
    feeder.send(messages.SNAPSHOT, {"mark": None})
    written, _ = feeder.answer(messages.SNAPSHOTTED)
    assert written["error"] == "Is a directory"


def test_whatever_a_request_raises_is_answered_and_the_worker_goes_on(
    feeder: Feeder, caplog: pytest.LogCaptureFixture
) -> None:
    feeder.start_worker()
    feeder.block(0, frames())
    feeder.answer(messages.DONE)
    with caplog.at_level(logging.CRITICAL):
        for number, (operation, arguments, error) in enumerate(
            (
                ("spectrum", {"ue": 5000}, "UE 5000 is not on the chart"),
                ("spectrum", {"who": 1}, "spectrum failed: 'ue'"),
                ("dance", {}, "a worker knows no operation 'dance'"),
            )
        ):
            feeder.send(messages.REQUEST, {"id": number, "operation": operation, "arguments": arguments})
            assert feeder.answer(messages.REPLY)[0] == {"id": number, "error": error}
    ue = int(frames().ue[0])
    feeder.send(messages.REQUEST, {"id": 9, "operation": "spectrum", "arguments": {"ue": ue}})
    assert feeder.answer(messages.REPLY)[0]["result"]["theta_spectrum"]


def test_it_says_hello_again_when_asked_and_that_it_lives_when_idle(feeder: Feeder) -> None:
    feeder.start_worker()
    feeder.answer(messages.ALIVE)
    feeder.block(0, frames())
    feeder.send(messages.WHO, {})
    assert feeder.answer(messages.HELLO)[0]["seq"] == 0
