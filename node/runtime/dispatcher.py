"""The dispatcher: hands blocks to the workers, and what comes back to the main process.

One ROUTER socket serves all workers. A worker says hello and gets as many blocks as it has credit for, each
with the methods that it is to be estimated with; each answer is acknowledgement and result in one and frees
one credit.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import deque
from typing import Any

import numpy as np
import zmq

from chachart.node.data.errors import RequestError
from chachart.node.net.wire import encode_csi
from chachart.node.runtime import messages
from chachart.node.runtime.child import load_class
from chachart.node.runtime.csi_sinks import CsiSinks
from chachart.node.runtime.partition import Partitioner, shard_of
from chachart.node.runtime.reader import Reader
from chachart.node.runtime.shard_queue import ShardQueue
from chachart.node.runtime.shard_queues import ShardQueues
from chachart.sources.base import Source

log = logging.getLogger(__name__)

STATUS_EVERY_S = 0.25


class Dispatcher:
    """The loop that hands blocks to the workers. `run` returns when everything is drained."""

    def __init__(
        self,
        settings: dict[str, Any],
        source: Source,
        context: zmq.Context[zmq.Socket[bytes]],
        results: zmq.Socket[bytes],
    ) -> None:
        self._settings = settings
        self._source = source
        self._results = results
        self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        count = settings["workers"]["count"]
        self._queues = ShardQueues(
            [
                ShardQueue(
                    settings["workers"]["queue_blocks"], settings["workers"]["credit_blocks"], source.lossless
                )
                for _ in range(count)
            ],
            source.lossless,
            self._wake,
        )
        partitioner = Partitioner(
            count, settings["workers"]["block_frames"], settings["workers"]["linger_ms"] / 1e3
        )
        self._reader = Reader(source, partitioner, self._queues)
        self._csi_sinks = CsiSinks(self._reader, source.array, source.lossless)
        self._identity: list[bytes | None] = [None] * count
        self._worker_status: list[dict[str, Any]] = [{} for _ in range(count)]
        estimator = settings["estimator"]
        self._method: tuple[str, str] = (estimator["theta"], estimator["rho"])
        self._round = 0
        self._replies: deque[dict[str, Any]] = deque()
        self._go = False
        self._started = False
        self._stop_at: float | None = None
        self._workers = context.socket(zmq.ROUTER)
        self._commands = context.socket(zmq.PULL)
        self._workers.set_hwm(0)
        self._workers.bind(settings["sockets"]["workers"])
        self._commands.bind(settings["sockets"]["commands"])
        self._poller = zmq.Poller()
        for socket in (self._workers, self._commands, self._wake_fd):
            self._poller.register(socket, zmq.POLLIN)

    def run(self) -> None:
        """Open everything, feed the workers until the source has ended or `stop` came, and drain.

        Raises
        ------
        SetupError
            If the source or a CSI sink cannot be opened.
        """
        self._source.open()
        try:
            for spec in self._settings["csi_sinks"]:
                self._csi_sinks.add(load_class(spec["class"]), spec["settings"])
            self._tell(messages.READY, {"lossless": self._source.lossless})
            self._serve()
        finally:
            self._csi_sinks.close(self._time_left())
            self._source.close()
        self._tell(messages.DRAINED, self._status())

    def _serve(self) -> None:
        next_status = 0.0
        while not self._finished():
            events = dict(self._poller.poll(int(STATUS_EVERY_S * 1e3)))
            if self._wake_fd in events:
                os.eventfd_read(self._wake_fd)
            if self._workers in events:
                self._hear_workers()
            if self._commands in events:
                self._obey()
            self._send_blocks()
            while self._replies:
                self._reply(self._replies.popleft())
            if time.monotonic() >= next_status:
                next_status = time.monotonic() + STATUS_EVERY_S
                self._tell(messages.STATUS, self._status())
        self._queues.settle(self._reader.frames_in, "source_failed")
        for identity in filter(None, self._identity):
            self._workers.send_multipart([identity, messages.END])

    def _finished(self) -> bool:
        if self._stop_at is not None and time.monotonic() >= self._stop_at:
            self._abandon()
            return True
        if not self._started:
            return self._stop_at is not None
        return self._reader.ended and self._queues.empty

    def _abandon(self) -> None:
        self._queues.abandon("drain_deadline")
        self._reader.join(timeout=1.0)
        self._queues.settle(self._reader.frames_in, "drain_deadline")

    def _hear_workers(self) -> None:
        while True:
            try:
                identity, kind, *parts = self._workers.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            values = messages.unpack(parts[0])
            if kind == messages.DONE:
                self._done(identity, values, parts[1])
            elif kind == messages.HELLO:
                self._hello(identity, values)
            elif kind == messages.REPLY:
                self._tell(messages.REPLY, values)

    def _hello(self, identity: bytes, values: dict[str, Any]) -> None:
        shard = values["shard"]
        if self._identity[shard] is not None:
            self._worker_lost(shard)
        self._identity[shard] = identity
        self._worker_status[shard] = {"pid": values["pid"]}
        configure = messages.pack({"live": not self._source.lossless})
        self._workers.send_multipart([identity, messages.CONFIGURE, configure])
        self._tell(messages.HELLO, values)
        self._start_when_ready()

    def _done(self, identity: bytes, values: dict[str, Any], update: bytes) -> None:
        if identity not in self._identity:
            return
        shard = self._identity.index(identity)
        done = self._queues.acknowledge(shard, values["seqs"], values["estimated"], values["dropped"])
        if not done:
            return
        self._worker_status[shard].update(ues=values["ues"], **values["counters"])
        if update:
            header = messages.pack({"arrivals": [pair for content in done for pair in content.arrivals]})
            self._results.send_multipart([messages.UPDATE, header, update])

    def _send_blocks(self) -> None:
        for shard, identity in enumerate(self._identity):
            while identity is not None and (entry := self._queues.take(shard, self._method)):
                header = messages.pack({"seq": entry.seq, "method": entry.method, "round": self._round})
                parts = [identity, messages.BLOCK, header, *encode_csi(entry.content.block)]
                self._workers.send_multipart(parts, copy=False)

    def _obey(self) -> None:
        while True:
            try:
                kind, body = self._commands.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            values = messages.unpack(body)
            if kind == messages.GO:
                self._go = True
                self._start_when_ready()
            elif kind == messages.STOP:
                self._reader.stop()
                self._stop_at = time.monotonic() + values["within_s"]
            elif kind == messages.LOST:
                if self._worker_status[values["shard"]].get("pid") == values["pid"]:
                    self._worker_lost(values["shard"])
            elif kind == messages.REQUEST:
                self._request(values)

    def _start_when_ready(self) -> None:
        if self._go and not self._started and self._stop_at is None and all(self._identity):
            self._started = True
            self._reader.start()
            self._tell(messages.STARTED, {})

    def _worker_lost(self, shard: int) -> None:
        self._identity[shard] = None
        self._worker_status[shard] = {}
        frames = self._queues.worker_lost(shard)
        if frames:
            log.warning("worker %d: %d unacknowledged frames wait for its successor", shard, frames)

    def _request(self, values: dict[str, Any]) -> None:
        operation, arguments = values["operation"], values["arguments"]
        if operation == "set_method":
            self._method = (arguments["theta"], arguments["rho"])
            self._reply({"id": values["id"], "result": arguments})
        elif operation == "replay":
            self._replay(values)
        elif operation in ("start_recording", "stop_recording"):
            threading.Thread(target=self._record, args=(values,), name="record", daemon=True).start()
        else:
            shard = int(shard_of(np.array([arguments["ue"]], np.uint64), len(self._identity))[0])
            worker = self._identity[shard]
            if worker is None:
                error = f"worker {shard}, which has UE {arguments['ue']}, is being restarted"
                self._reply({"id": values["id"], "error": error})
            else:
                self._workers.send_multipart([worker, messages.REQUEST, messages.pack(values)])

    def _replay(self, values: dict[str, Any]) -> None:
        """Steer the source; after a jump, what workers know of UEs is of another time."""
        before, wishes = self._source.details(), values["arguments"]
        try:
            plays = self._source.replay(**wishes)
        except RequestError as error:
            self._reply({"id": values["id"], "error": str(error)})
            return
        jumped = wishes["at_s"] is not None or (before["replay"]["ended"] and not plays["ended"])
        self._round += jumped
        self._reply({"id": values["id"], "result": {**plays, "jumped": jumped}})

    def _record(self, values: dict[str, Any]) -> None:
        answer: dict[str, Any] = {"id": values["id"]}
        try:
            if values["operation"] == "start_recording":
                answer["result"] = self._csi_sinks.start_recording(values["arguments"]["path"])
            else:
                answer["result"] = self._csi_sinks.stop_recording()
        except RequestError as error:
            answer["error"] = str(error)
        except Exception as error:
            log.exception("%s failed", values["operation"])
            answer["error"] = f"{values['operation']} failed: {error}"
        self._replies.append(answer)
        self._wake()

    def _reply(self, values: dict[str, Any]) -> None:
        """Answer a request; the status goes first, so that nobody sees one from before the change."""
        self._tell(messages.STATUS, self._status())
        self._tell(messages.REPLY, values)

    def _status(self) -> dict[str, Any]:
        estimated, dropped, shards = self._queues.totals()
        workers = [{**status, **shard} for status, shard in zip(self._worker_status, shards, strict=True)]
        return {
            "method": dict(zip(("theta", "rho"), self._method, strict=True)),
            "frames_estimated": estimated,
            "dropped": dropped.as_dict(),
            "workers": workers,
            "source": self._source.details(),
            "csi_sinks": self._csi_sinks.status(),
            "recording": self._csi_sinks.recording(),
            "failure": self._reader.failure,
            **self._reader.status(),
        }

    def _tell(self, kind: bytes, values: dict[str, Any]) -> None:
        self._results.send_multipart([kind, messages.pack(values)])

    def _wake(self) -> None:
        os.eventfd_write(self._wake_fd, 1)

    def _time_left(self) -> float:
        return 5.0 if self._stop_at is None else max(1.0, self._stop_at - time.monotonic())
