"""A dispatcher with the test at the other ends of its sockets: the workers' and the main process's."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq
from csi_samples import small_array, some_block

from chachart.node.data.csi import CsiBlock
from chachart.node.net.wire import decode_csi
from chachart.node.runtime import messages
from chachart.node.runtime.dispatcher import Dispatcher
from chachart.node.runtime.worker_state import Done
from chachart.sources.base import EndOfSource, Source, SourceSettings

ARRAY = small_array(4, 3)
DEADLINE_MS = 60_000
FRAMES, BLOCKS = 10, 6


class Listed(Source):
    """Gives so many blocks, and ends when it is told to."""

    Settings = SourceSettings
    lossless = True

    def __init__(self) -> None:
        super().__init__(SourceSettings(type="listed"), ARRAY)
        self.may_end = threading.Event()
        self._given = 0

    def open(self) -> None: ...

    def recv(self, timeout: float) -> CsiBlock | None:
        if self._given < BLOCKS:
            self._given += 1
            return some_block(FRAMES, seq=(self._given - 1) * FRAMES, antennas=4, subcarriers=3)
        if self.may_end.wait(timeout):
            raise EndOfSource
        return None


class Surroundings:
    """The processes around a dispatcher, as their sockets see it."""

    def __init__(self, folder: Path, workers: int) -> None:
        self.context = zmq.Context()
        self.source = Listed()
        self._folder = folder
        self._workers: list[zmq.Socket[bytes]] = []
        ends = {name: f"ipc://{folder}/{name}" for name in ("workers", "commands", "results")}
        self._results = self.context.socket(zmq.PULL)
        self._results.bind(ends["results"])
        push = self.context.socket(zmq.PUSH)
        push.connect(ends["results"])
        settings: dict[str, Any] = {
            "workers": {
                "count": workers,
                "queue_blocks": 8,
                "credit_blocks": 2,
                "block_frames": 16,
                "linger_ms": 1.0,
            },
            "state": {"retain_mib": 1.0, "every_s": 0.0, "directory": None},
            "estimator": {"theta": "bartlett", "rho": "bartlett"},
            "sockets": ends,
            "keys": None,
            "tally": str(folder / "tally"),
            "time_tolerance_s": math.inf,
            "csi_sinks": [],
            "counted": None,
            "facts": {},
        }
        self.dispatcher = Dispatcher(settings, self.source, self.context, push)
        self._commands = self.context.socket(zmq.PUSH)
        self._commands.connect(ends["commands"])
        self._thread = threading.Thread(target=self.dispatcher.run)
        self._thread.start()

    def command(self, kind: bytes, **values: Any) -> None:
        self._commands.send_multipart([kind, messages.pack(values)])

    def told(self, kind: bytes) -> dict[str, Any]:
        """The next message of that kind to the main process."""
        while self._results.poll(DEADLINE_MS):
            found, body, *_ = self._results.recv_multipart()
            if found == kind:
                return messages.unpack(body)
        raise AssertionError(f"no {kind!r} came")

    def worker(self, shard: int, done: Done | None = None, pid: int = 1) -> zmq.Socket[bytes]:
        """One that has said hello and was answered."""
        socket = self.context.socket(zmq.DEALER)
        self._workers.append(socket)
        socket.connect(f"ipc://{self._folder}/workers")
        hello = {"shard": shard, "pid": pid, "host": "here", "ues": 0, **(done or Done()).facts()}
        socket.send_multipart([messages.HELLO, messages.pack(hello)])
        assert received(socket)[0] == messages.CONFIGURE
        return socket

    def close(self) -> None:
        self.source.may_end.set()
        self.command(messages.STOP, within_s=0.0)
        self._thread.join(DEADLINE_MS / 1e3)
        self.context.destroy(linger=0)
        assert not self._thread.is_alive()


def received(worker: zmq.Socket[bytes]) -> list[bytes]:
    assert worker.poll(DEADLINE_MS), "nothing came"
    return worker.recv_multipart()


def block(worker: zmq.Socket[bytes]) -> tuple[dict[str, Any], CsiBlock]:
    kind, header, *csi = received(worker)
    assert kind == messages.BLOCK
    return messages.unpack(header), decode_csi(csi)


def acknowledge(worker: zmq.Socket[bytes], header: dict[str, Any], frames: int) -> None:
    answer = {"seqs": [header["seq"]], "estimated": frames, "dropped": {}, "ues": 1}
    answer |= {"arrays": [], "counters": {}}
    worker.send_multipart([messages.DONE, messages.pack(answer), b""])


@pytest.fixture
def surroundings(tmp_path: Path) -> Iterator[Surroundings]:
    around = Surroundings(tmp_path, workers=1)
    yield around
    around.close()


def test_every_frame_goes_to_its_worker_once_and_is_counted(surroundings: Surroundings) -> None:
    worker = surroundings.worker(0)
    surroundings.command(messages.GO)
    surroundings.told(messages.STARTED)
    got: list[int] = []
    while len(got) < FRAMES * BLOCKS:
        header, csi = block(worker)
        assert len(csi) <= 16
        got += csi.time_ns.tolist()
        acknowledge(worker, header, len(csi))
    surroundings.source.may_end.set()
    drained = surroundings.told(messages.DRAINED)
    assert (drained["frames_in"], drained["frames_estimated"]) == (FRAMES * BLOCKS, FRAMES * BLOCKS)
    assert drained["dropped"] == {}
    assert received(worker)[0] == messages.END


def test_a_worker_holds_no_more_than_its_credit(surroundings: Surroundings) -> None:
    worker = surroundings.worker(0)
    surroundings.command(messages.GO)
    held = [block(worker), block(worker)]
    surroundings.command(messages.REQUEST, id=1, operation="spectrum", arguments={"ue": 0})
    assert received(worker)[0] == messages.REQUEST, "a request comes next, not a third block"
    acknowledge(worker, held[0][0], len(held[0][1]))
    assert block(worker)[0]["seq"] == 2


def test_what_a_dead_worker_held_goes_to_its_successor(surroundings: Surroundings) -> None:
    worker = surroundings.worker(0, pid=7)
    surroundings.command(messages.GO)
    held = [block(worker), block(worker)]
    worker.close(linger=0)
    surroundings.command(messages.LOST, shard=0, pid=7)
    successor = surroundings.worker(0, pid=8)
    again = [block(successor), block(successor)]
    assert [header["seq"] for header, _ in again] == [header["seq"] for header, _ in held]
    assert [csi.time_ns.tolist() for _, csi in again] == [csi.time_ns.tolist() for _, csi in held]


def test_requests_are_answered_by_the_dispatcher_or_by_the_worker(surroundings: Surroundings) -> None:
    worker = surroundings.worker(0)
    method = {"theta": "music", "rho": "bartlett"}
    surroundings.command(messages.REQUEST, id=1, operation="set_method", arguments=method)
    assert surroundings.told(messages.REPLY) == {"id": 1, "result": method}
    surroundings.command(messages.REQUEST, id=2, operation="spectrum", arguments={"ue": 5})
    kind, body = received(worker)
    assert (kind, messages.unpack(body)["arguments"]) == (messages.REQUEST, {"ue": 5})
    worker.send_multipart([messages.REPLY, messages.pack({"id": 2, "result": {"ue": 5}})])
    assert surroundings.told(messages.REPLY) == {"id": 2, "result": {"ue": 5}}
    surroundings.command(messages.GO)
    assert tuple(block(worker)[0]["method"]) == ("music", "bartlett")


def test_nothing_is_read_before_all_workers_are_there(tmp_path: Path) -> None:
    around = Surroundings(tmp_path, workers=2)
    try:
        around.worker(0)
        around.command(messages.GO)
        around.command(messages.REQUEST, id=1, operation="spectrum", arguments={"ue": 2**63})
        status = around.told(messages.STATUS)
        assert (status["frames_in"], status["ended"]) == (0, False)
        around.worker(1)
        around.told(messages.STARTED)
    finally:
        around.close()
