"""A worker process: takes blocks from the feeder, answers each with its acknowledgement and result in one.

Since both are one message, a block counts as estimated if and only if it is acknowledged: a worker that is
killed can neither lose a frame nor have it counted twice.
"""

from __future__ import annotations

import logging
import os
from typing import Any

import zmq

from chachart.node.counters import Counters
from chachart.node.errors import RequestError
from chachart.node.geometry import ArrayGeometry
from chachart.node.runtime import messages
from chachart.node.runtime.child import read_settings
from chachart.node.runtime.processor import BlockProcessor, FrameClock
from chachart.node.wire import decode_csi

log = logging.getLogger(__name__)

IDLE_MS = 500


class Worker:
    """The loop around a `BlockProcessor`."""

    def __init__(self, settings: dict[str, Any], socket: zmq.Socket[bytes]) -> None:
        self._shard: int = settings["shard"]
        self._processor = BlockProcessor(
            ArrayGeometry.from_dict(settings["array"]), settings["estimator"], FrameClock(live=False)
        )
        self._socket = socket
        self._last = -1
        self._counters = Counters()

    def run(self) -> None:
        """Serve until the feeder says that nothing more will come."""
        hello = {"shard": self._shard, "pid": os.getpid(), "last": self._last}
        self._socket.send_multipart([messages.HELLO, messages.pack(hello)])
        while True:
            if self._socket.poll(IDLE_MS):
                kind, *parts = self._socket.recv_multipart(copy=False)
                if kind.bytes == messages.END:
                    return
                self._handle(kind.bytes, [part.buffer for part in parts])
            self._processor.forget()

    def _handle(self, kind: bytes, parts: list[memoryview]) -> None:
        values = messages.unpack(parts[0])
        if kind == messages.BLOCK:
            self._block(values["seq"], parts[1:])
        elif kind == messages.CONFIGURE:
            self._processor.clock.live = values["live"]
            self._processor.request("set_method", values)
        elif kind == messages.REQUEST:
            self._request(values)

    def _block(self, seq: int, parts: list[memoryview]) -> None:
        if self._last >= 0 and seq != self._last + 1:
            self._counters.add("gaps" if seq > self._last else "out_of_order")
        self._last = seq
        outcome = self._processor.process(decode_csi(parts))
        answer = {
            "seq": seq,
            "estimated": outcome.estimated,
            "dropped": outcome.dropped,
            "ues": self._processor.ues,
            "counters": {"untrained": self._processor.untrained, **self._counters.as_dict()},
        }
        result = b"" if outcome.update is None else messages.pack_update(outcome.update)
        self._socket.send_multipart([messages.DONE, messages.pack(answer), result])

    def _request(self, values: dict[str, Any]) -> None:
        answer: dict[str, Any] = {"id": values["id"]}
        try:
            answer["result"] = self._processor.request(values["operation"], values["arguments"])
        except RequestError as error:
            answer["error"] = str(error)
        self._socket.send_multipart([messages.REPLY, messages.pack(answer)])


def main() -> None:
    """Run as `python -m chachart.node.runtime.worker`, settings on stdin."""
    settings = read_settings()
    context = zmq.Context()
    socket = context.socket(zmq.DEALER)
    socket.set_hwm(0)
    socket.linger = 1000
    socket.connect(settings["workers"])
    try:
        Worker(settings, socket).run()
    finally:
        context.destroy()


if __name__ == "__main__":
    main()
