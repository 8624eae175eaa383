"""A worker process: takes blocks from the feeder, answers each with its acknowledgement and result in one.

Since both are one message, a block counts as estimated if and only if it is acknowledged: a worker that is
killed can neither lose a frame nor have it counted twice. What it has learnt from acknowledged frames is in
its snapshots; blocks since the last one come again to its successor.
"""

from __future__ import annotations

import logging
import os
import platform
import sys
import time
from typing import Any

import numpy as np
import zmq

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import RequestError, SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.files.folders import FolderError
from chachart.node.files.url_folders import folder_at
from chachart.node.net.doorkeeper import HEARTBEAT_MS, SILENCE_MS
from chachart.node.net.wire import decode_csi
from chachart.node.runtime import messages
from chachart.node.runtime.child import LACKS, leave_alone_what_lives, read_settings
from chachart.node.runtime.processor import BlockProcessor, FrameClock, Outcome, estimator_of
from chachart.node.runtime.progress import Mark
from chachart.node.runtime.worker_state import WorkerState

log = logging.getLogger(__name__)

IDLE_MS = 500
WRITING_MS = 20
MERGE_BYTES = 2 * 1024 * 1024
"""Blocks that have queued up are estimated as one up to this size: fewer calls, still within the cache."""
ROWS_AT_ONCE = 8192

WARM_UP_FRAMES = 64

Message = tuple[bytes, list[memoryview]]


class Worker:
    """The loop around a `BlockProcessor`."""

    def __init__(self, settings: dict[str, Any], socket: zmq.Socket[bytes]) -> None:
        self._shard: int = settings["shard"]
        self._count: int = settings["count"]
        self._merge_frames: int = settings["estimator"]["max_ues"]
        self._array = ArrayGeometry.from_dict(settings["array"])
        self._estimator: dict[str, Any] = settings["estimator"]
        self._several: dict[str, Any] | None = settings["several"]
        clock = FrameClock(live=False)
        self._processor = BlockProcessor(self._array, self._estimator, clock, self._several)
        state = settings["state"]
        folder = None if state["folder"] is None else folder_at(state["folder"])
        self._state = WorkerState(folder, self._shard, self._count, state["durable"])
        self._done = self._state.restore(self._processor)
        self._snapshot_seq = -1
        self._snapshot_started = 0.0
        self._socket = socket
        self._put_back: Message | None = None
        self._counters = Counters()

    def run(self) -> None:
        """Serve until the feeder says that nothing more will come."""
        warm_up(self._array, self._estimator, self._several)
        leave_alone_what_lives()
        self._hello()
        while (message := self._receive(self._patience_ms())) is None or message[0] != messages.END:
            if message is not None:
                self._handle(*message)
            else:
                self._socket.send_multipart([messages.ALIVE, messages.pack({})])
            self._processor.forget()
            self._look_at_writer()

    def _patience_ms(self) -> int:
        return WRITING_MS if self._state.writing else IDLE_MS

    def _receive(self, timeout_ms: int) -> Message | None:
        """The message that was put back, or else the next one; None if none comes in time."""
        if self._put_back is not None:
            message, self._put_back = self._put_back, None
            return message
        if not self._socket.poll(timeout_ms):
            return None
        kind, *parts = self._socket.recv_multipart(copy=False)
        return kind.bytes, [part.buffer for part in parts]

    def _handle(self, kind: bytes, parts: list[memoryview]) -> None:
        if kind == messages.BLOCK:
            self._blocks(parts)
        elif kind == messages.SNAPSHOT:
            self._snapshot(messages.unpack(parts[0]))
        elif kind == messages.CONFIGURE:
            self._configure(messages.unpack(parts[0]))
        elif kind == messages.REQUEST:
            self._request(messages.unpack(parts[0]))
        elif kind == messages.WHO:
            self._hello()

    def _hello(self) -> None:
        who = {"shard": self._shard, "pid": os.getpid(), "host": platform.node()}
        hello = {**who, "ues": self._processor.ues, **self._done.facts()}
        self._socket.send_multipart([messages.HELLO, messages.pack(hello)])

    def _configure(self, values: dict[str, Any]) -> None:
        self._processor.clock.live = values["live"]
        self._done.estimated += values["lost"]
        if values["rows"] and (rows := self._processor.rows()) is not None:
            for part in rows.parts(ROWS_AT_ONCE):
                self._socket.send_multipart([messages.ROWS, messages.pack({}), messages.pack_update(part)])

    def _blocks(self, parts: list[memoryview]) -> None:
        """Estimate this block together with those that wait behind it, and acknowledge them all."""
        first = messages.unpack(parts[0])
        headers = [first]
        blocks = [decode_csi(parts[1:])]
        frames, size = len(blocks[0]), blocks[0].csi.nbytes
        while (message := self._receive(0)) is not None and message[0] == messages.BLOCK:
            header, block = messages.unpack(message[1][0]), decode_csi(message[1][1:])
            frames, size = frames + len(block), size + block.csi.nbytes
            alike = all(header[key] == first[key] for key in ("method", "round", "again"))
            alike &= self._several is not None or block.array == blocks[0].array
            if frames > self._merge_frames or size > MERGE_BYTES or not alike:
                break
            headers.append(header)
            blocks.append(block)
        self._put_back = message
        if first["round"] != self._done.round:
            self._done.round = first["round"]
            self._processor.start_over()
        outcome = self._processor.process_all(blocks, *first["method"])
        for header in headers:
            self._count_block(header)
        self._done.estimated += outcome.estimated
        self._done.rejected.merge(outcome.dropped)
        self._answer([header["seq"] for header in headers], outcome, again=first["again"])

    def _answer(self, seqs: list[int], outcome: Outcome, again: bool) -> None:
        answer = {
            "seqs": seqs,
            "estimated": outcome.estimated,
            "dropped": outcome.dropped,
            "ues": self._processor.ues,
            "counters": {"untrained": self._processor.untrained, **self._counters.as_dict()},
            "arrays": self._processor.array_report(),
        }
        known = outcome.update is None or again
        result = b"" if known or outcome.update is None else messages.pack_update(outcome.update)
        self._socket.send_multipart([messages.DONE, messages.pack(answer), result])

    def _count_block(self, header: dict[str, Any]) -> None:
        seq: int = header["seq"]
        if seq != self._done.seq + 1:
            self._counters.add("gaps" if seq > self._done.seq else "out_of_order")
        self._done.seq = seq
        self._take_mark(header["mark"], header["end"])

    def _take_mark(self, mark: dict[str, Any] | None, below: int) -> None:
        """All frames of this shard below `below`, and below the mark, are in the state."""
        if mark is not None:
            self._done.mark = Mark(**mark)
        self._done.applied_below(self._count, self._shard, max(below, self._done.mark.frame))

    def _snapshot(self, values: dict[str, Any]) -> None:
        if self._state.writing:
            return
        self._take_mark(values["mark"], 0)
        self._snapshot_seq, self._snapshot_started = self._done.seq, time.monotonic()
        try:
            self._state.begin(self._processor, self._done)
        except OSError as error:
            self._tell_snapshot(error.strerror or str(error))

    def _look_at_writer(self) -> None:
        if self._state.writing:
            error = self._state.wait()
            if not self._state.writing:
                self._tell_snapshot(error)

    def _tell_snapshot(self, error: str | None) -> None:
        seconds = time.monotonic() - self._snapshot_started
        answer = {"seq": self._snapshot_seq, "seconds": seconds, "error": error}
        self._socket.send_multipart([messages.SNAPSHOTTED, messages.pack(answer)])

    def _request(self, values: dict[str, Any]) -> None:
        """Answer a request; one that fails, for whatever reason, costs an error message and nothing else."""
        answer: dict[str, Any] = {"id": values["id"]}
        try:
            answer["result"] = self._processor.answer(values["operation"], values["arguments"])
        except RequestError as error:
            answer["error"] = str(error)
        except Exception as error:
            log.exception("%s failed", values["operation"])
            answer["error"] = f"{values['operation']} failed: {error}"
        self._socket.send_multipart([messages.REPLY, messages.pack(answer)])


def warm_up(array: ArrayGeometry, estimator: dict[str, Any], several: dict[str, Any] | None = None) -> None:
    """Estimate noise with a throw-away estimator: the first call takes longer than live frames can wait."""
    frame_bytes = 8 * array.antennas * array.subcarriers
    frames = min(max(MERGE_BYTES // frame_bytes, 1), WARM_UP_FRAMES)
    shape = (frames, array.antennas, 2 * array.subcarriers)
    noise = np.random.default_rng(0).standard_normal(shape, np.float32).view(np.complex64)
    block = CsiBlock(array.name, 0, np.arange(frames, dtype=np.uint64), np.zeros(frames, np.int64), noise)
    made = estimator_of(array, estimator, several)
    made.update(block)
    if isinstance(made, FusedEstimator):
        made.flush()


def main() -> int:
    """Run as `python -m chachart.node.runtime.worker`, settings on stdin."""
    settings = read_settings()
    context = zmq.Context()
    socket = context.socket(zmq.DEALER)
    socket.set_hwm(0)
    socket.linger = 1000
    if (curve := settings["curve"]) is not None:
        socket.curve_publickey, socket.curve_secretkey = curve["public"].encode(), curve["secret"].encode()
        socket.curve_serverkey = curve["server"].encode()
        socket.heartbeat_ivl, socket.heartbeat_timeout = HEARTBEAT_MS, SILENCE_MS
    socket.connect(settings["workers"])
    try:
        Worker(settings, socket).run()
    except FolderError as error:
        log.error("%s is out of reach: %s", settings["state"]["folder"], error.strerror)
        return LACKS
    except SetupError as error:  # what fsspec needs is not on this machine
        log.error("%s", error)
        return LACKS
    finally:
        context.destroy()
    return 0


if __name__ == "__main__":
    sys.exit(main())
