"""The dispatcher: hands blocks to the workers, and what comes back to the main process.

A worker says hello and gets as many blocks as it has credit for, each with the methods that it is to be
estimated with; each answer is acknowledgement and result in one and frees one credit. Now and then a worker
is told to write a snapshot of its state: what it acknowledged before need not be sent to a successor again.
"""

from __future__ import annotations

import logging
import math
import os
import time
from pathlib import Path
from typing import Any

import zmq

from chachart.node.runtime import messages
from chachart.node.runtime.child import leave_alone_what_lives, load_class
from chachart.node.runtime.csi_sinks import CsiSinks
from chachart.node.runtime.feeder_requests import FeederRequests, Terms
from chachart.node.runtime.going_on import go_on
from chachart.node.runtime.hung_workers import HungWorkers
from chachart.node.runtime.partition import Partitioner
from chachart.node.runtime.progress import Mark
from chachart.node.runtime.reader import Reader, Tally
from chachart.node.runtime.shard_queue import ShardQueue
from chachart.node.runtime.shard_queues import ShardQueues
from chachart.node.runtime.snapshot_schedule import SnapshotKeeper
from chachart.node.runtime.worker_links import Peer, WorkerLinks
from chachart.sources.base import Source

log = logging.getLogger(__name__)

STATUS_EVERY_S = 0.25
LAST_SNAPSHOT_S = 5.0


class StartOver(Exception):
    """What a worker needs can only be read again: the feeder has to begin anew at an earlier mark."""


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
        workers, state = settings["workers"], settings["state"]
        count = self._count = workers["count"]
        retain_bytes = int(state["retain_mib"] * 2**20 / count) if state["every_s"] else 0
        self._queues = ShardQueues(
            [
                ShardQueue(
                    workers["queue_blocks"],
                    workers["credit_blocks"],
                    source.lossless,
                    retain_bytes,
                    workers["block_frames"],
                    workers["linger_ms"] / 1e3,
                )
                for _ in range(count)
            ],
            source.lossless,
            self._wake,
        )
        partitioner = Partitioner(count, workers["block_frames"])
        tally = Tally(Path(settings["tally"]))
        self._reader = Reader(source, partitioner, self._queues, tally, settings["time_tolerance_s"])
        self._csi_sinks = CsiSinks(self._reader, source, settings["facts"])
        self._hellos: list[dict[str, Any]] = [{} for _ in range(count)]
        self._terms = Terms((settings["estimator"]["theta"], settings["estimator"]["rho"]))
        self._go = False
        self._started = False
        self._stop_at: float | None = None
        self._commands = context.socket(zmq.PULL)
        self._commands.bind(settings["sockets"]["commands"])
        self._links = WorkerLinks(context, settings["sockets"]["workers"], settings["keys"], count)
        self._hung = HungWorkers(self._links, self._queues)
        self._snapshots = SnapshotKeeper(self._queues, self._links, state["every_s"])
        antennas = self._reader.antennas
        self._requests = FeederRequests(
            self._terms, source, antennas, self._csi_sinks, self._links, self._reply, self._wake
        )
        self._poller = zmq.Poller()
        for socket in (self._links.socket, self._commands, self._wake_fd):
            self._poller.register(socket, zmq.POLLIN)

    def run(self) -> None:
        """Open everything, feed the workers until the source has ended or `stop` came, and drain.

        Raises
        ------
        SetupError
            If the source or a CSI sink cannot be opened.
        StartOver
            If a worker needs what can only be read again.
        """
        self._source.open()
        try:
            for spec in self._settings["csi_sinks"]:
                self._csi_sinks.add(load_class(spec["class"]), spec["settings"])
            for shard in range(self._count):
                with self._queues.shard(shard) as queue:
                    queue.can_read_again = self._source.lossless and self._source.position() is not None
            self._tell(messages.READY, {"lossless": self._source.lossless})
            self._serve()
        finally:
            self._csi_sinks.close(self._time_left(), self._still_here)
            self._source.close()
            self._links.close()
        self._tell(messages.DRAINED, self._status())

    def _still_here(self) -> bool:
        """What there is to do while CSI sinks finish; whether one that gets on may go on."""
        self._obey()
        self._tell(messages.STATUS, self._status())
        return self._source.lossless and self._stop_at is None

    def _serve(self) -> None:
        next_status = 0.0
        while not self._finished():
            self._pass()
            self._send_blocks()
            now = time.monotonic()
            if now >= next_status:
                next_status = now + STATUS_EVERY_S
                self._tell(messages.STATUS, self._status())
                self._look_for_hung(now)
                for shard in range(self._count):
                    self._snapshots.ask_where_due(shard, self._reader.marks, self._reader.passed_on)
        self._queues.settle(self._reader.frames_in, "source_failed")
        if self._settings["state"]["directory"] is not None:
            self._last_snapshots()
        for shard in range(self._count):
            self._links.send(shard, messages.END, {})

    def _pass(self) -> None:
        """Wait for something to happen, and take what has come."""
        patience = min(self._queues.deadline() - time.monotonic(), STATUS_EVERY_S)
        events = dict(self._poller.poll(math.ceil(max(patience, 0.0) * 1e3)))
        if self._wake_fd in events:
            os.eventfd_read(self._wake_fd)
        self._hear_workers()
        if self._commands in events:
            self._obey()
        self._requests.reply_to_slow_ones()

    def _finished(self) -> bool:
        if self._stop_at is not None and time.monotonic() >= self._stop_at:
            self._abandon()
            return True
        if not self._started:  # what an earlier feeder had read is still passed on
            return self._stop_at is not None and self._settings["counted"] is None
        return self._reader.ended and self._queues.empty

    def _abandon(self) -> None:
        self._queues.abandon("drain_deadline")
        self._reader.join(timeout=1.0)
        self._queues.settle(self._reader.frames_in, "drain_deadline")

    def _hear_workers(self) -> None:
        for shard, kind, values, rest in self._links.receive():
            if kind == messages.DONE:
                self._done(shard, values, rest[0])
            elif kind == messages.HELLO:
                self._hello(shard, values)
            elif kind == messages.ROWS:
                self._results.send_multipart([messages.UPDATE, messages.pack({"arrivals": []}), rest[0]])
            elif kind == messages.SNAPSHOTTED:
                self._snapshots.answered(shard, values)
            elif kind == messages.REPLY:
                self._reply(values)

    def _hello(self, shard: int, values: dict[str, Any]) -> None:
        before = self._links.peers[shard]
        if before is not None:
            self._worker_lost(shard)
        fresh = not self._hellos[shard]
        totals, ues = values["totals"], values["ues"]
        with self._queues.shard(shard) as queue:
            handover = queue.worker_up(
                values["seq"], totals["estimated"], totals["rejected"], self._hellos[shard].get("ues", 0)
            )
        if handover.lost:
            self._cannot_be_exact(shard, handover.lost)
        self._hellos[shard] = values
        self._hung.worker_up(shard)
        self._snapshots.worker_up(shard, Mark(**values["mark"]))
        heard_at = time.monotonic()
        self._links.peers[shard] = Peer(
            values["identity"], values["pid"], values["host"], heard_at, {"ues": ues}
        )
        answer = {
            "live": not self._source.lossless,
            "lost": handover.lost,
            "rows": ues > 0 and (fresh or handover.ahead),
        }
        self._links.send(shard, messages.CONFIGURE, answer)
        self._tell(messages.HELLO, {"shard": shard, "pid": values["pid"]})
        self._start_when_ready()

    def _cannot_be_exact(self, shard: int, lost: int) -> None:
        if self._source.lossless and self._source.position() is not None:
            raise StartOver(f"worker {shard} needs {lost} frames again")
        log.warning("worker %d: %d frames are in its UEs' estimates no more", shard, lost)

    def _done(self, shard: int, values: dict[str, Any], update: bytes) -> None:
        now = time.monotonic()
        done = self._queues.acknowledge(shard, values["seqs"], values["estimated"], values["dropped"], now)
        peer = self._links.peers[shard]
        if peer is not None:
            peer.status = {"ues": values["ues"], "arrays": values["arrays"], **values["counters"]}
            self._hellos[shard]["ues"] = values["ues"]
        if update and done:
            header = messages.pack({"arrivals": [pair for content in done for pair in content.arrivals]})
            self._results.send_multipart([messages.UPDATE, header, update])
        with self._queues.shard(shard) as queue:
            half = queue.half_retained
        if half:
            self._snapshots.ask_where_due(shard, self._reader.marks, self._reader.passed_on, early=True)

    def _send_blocks(self) -> None:
        now = time.monotonic()
        takers = [shard for shard, peer in enumerate(self._links.peers) if peer is not None]
        while takers:  # in turn, so that no worker waits for the blocks of another
            takers = [shard for shard in takers if self._send_block(shard, now)]

    def _send_block(self, shard: int, now: float) -> bool:
        entry = self._queues.take(shard, self._terms.method, now, self._terms.round)
        if entry is None:
            return False
        mark = self._snapshots.newer_mark(shard, self._reader.marks, entry.content.start)
        self._links.send_block(shard, entry, mark)
        return True

    def _last_snapshots(self) -> None:
        """Have everybody write down what a resumed node needs, when all is drained."""
        for shard in range(self._count):
            self._snapshots.ask(shard, self._reader.marks, self._reader.passed_on)
        deadline = time.monotonic() + LAST_SNAPSHOT_S
        while self._snapshots.writing() and time.monotonic() < deadline:
            self._pass()

    def _look_for_hung(self, now: float) -> None:
        for shard, pid in self._hung.look(now):
            self._tell(messages.HUNG, {"shard": shard, "pid": pid})
            self._worker_lost(shard)

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
                peer = self._links.peers[values["shard"]]
                if peer is not None and peer.pid == values["pid"]:
                    self._worker_lost(values["shard"])
            elif kind == messages.REQUEST:
                self._requests.handle(values)

    def _start_when_ready(self) -> None:
        if self._go and not self._started and all(peer is not None for peer in self._links.peers):
            self._terms.round = max(hello["round"] for hello in self._hellos)
            mark, counted = self._snapshots.oldest_mark, self._settings["counted"]
            go_on(self._hellos, mark, counted, self._source, self._queues, self._reader)
            self._started = True
            leave_alone_what_lives()
            self._reader.start()
            self._tell(messages.STARTED, {})

    def _worker_lost(self, shard: int) -> None:
        self._links.peers[shard] = None
        self._snapshots.worker_lost(shard)
        with self._queues.shard(shard) as queue:
            frames = queue.worker_lost()
        if frames:
            log.warning("worker %d: %d unacknowledged frames wait for its successor", shard, frames)

    def _reply(self, values: dict[str, Any]) -> None:
        """Answer a request; the status goes first, so that nobody sees one from before the change."""
        self._tell(messages.STATUS, self._status())
        self._tell(messages.REPLY, values)

    def _status(self) -> dict[str, Any]:
        estimated, dropped, shards = self._queues.totals()
        workers = [
            {
                **({} if peer is None else {"pid": peer.pid, "host": peer.host, **peer.status}),
                **shard,
                "snapshot_error": error,
                "stuck": stuck,
            }
            for peer, shard, error, stuck in zip(
                self._links.peers, shards, self._snapshots.errors, self._hung.reasons, strict=True
            )
        ]
        return {
            "method": dict(zip(("theta", "rho"), self._terms.method, strict=True)),
            "frames_estimated": estimated,
            "dropped": dropped.as_dict(),
            "dropped_here": self._queues.dropped_here(),
            "workers": workers,
            "source": self._reader.details(),
            "csi_sinks": self._csi_sinks.status(),
            "recording": self._csi_sinks.recording(),
            "failure": self._reader.failure,
            "complaint": self._source.complaint or self._reader.complaint,
            "ended": self._reader.ended,
            "source_silent_s": self._reader.source_silent_s,
            **self._reader.status(),
        }

    def _tell(self, kind: bytes, values: dict[str, Any]) -> None:
        self._results.send_multipart([kind, messages.pack(values)])

    def _wake(self) -> None:
        os.eventfd_write(self._wake_fd, 1)

    def _time_left(self) -> float:
        return 5.0 if self._stop_at is None else max(1.0, self._stop_at - time.monotonic())
