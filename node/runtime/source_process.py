"""A source process: one of several sources, which gives its blocks to the feeder process.

Where a node has one source, the feeder process reads it itself. Where it has several, each is in a process of
its own: whatever happens to it happens to nobody else.
"""

from __future__ import annotations

import logging
import sys
import time
from dataclasses import replace
from typing import Any

import zmq

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import EX_CONFIG, SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.security import SecuritySettings
from chachart.node.net.wire import encode_csi
from chachart.node.runtime import messages
from chachart.node.runtime.child import load_class, read_settings
from chachart.sinks.plain import plain
from chachart.sources.base import EndOfSource, Source

log = logging.getLogger(__name__)

RECV_TIMEOUT_S = 0.1
REPORT_EVERY_S = 0.25
HIGH_WATER = 16
"""Blocks on their way to the feeder process; a source that may lose frames loses the next ones."""


class SourceProcess:
    """The loop around a source that is open.

    Parameters
    ----------
    source
        It.
    socket
        A DEALER, connected to the feeder process.
    """

    def __init__(self, source: Source, socket: zmq.Socket[bytes]) -> None:
        self._source = source
        self._socket = socket
        self._names = {source.array.name, *(other.name for other in source.others)}
        self._reported = Counters()
        self._unsent = Counters()
        self._sent = 0
        self._next_report = 0.0
        self._started = self._stopped = False

    def run(self) -> None:
        """Read from when the feeder process says so until it says stop, which it does at the end too."""
        try:
            while not self._stopped:
                self._report()
                self._obey(0 if self._started else int(RECV_TIMEOUT_S * 1e3))
                if self._started and not self._stopped:
                    self._read()
        except EndOfSource:
            self._end()

    def _read(self) -> None:
        block = self._source.recv(RECV_TIMEOUT_S)
        if block is None:
            return
        if block.array not in self._names:
            block = replace(block, array=self._source.array.name)
        while not self._give(block):
            if not self._source.lossless:
                self._unsent.add("feeder_busy", len(block))
                return
            self._obey(int(RECV_TIMEOUT_S * 1e3))
            if self._stopped:
                return

    def _give(self, block: CsiBlock) -> bool:
        head = {"sent": self._sent, "position": self._source.position()}
        parts = [messages.BLOCK, messages.pack(head), *encode_csi(block)]
        try:
            self._socket.send_multipart(parts, zmq.NOBLOCK, copy=False)
        except zmq.Again:
            return False
        self._sent += len(block)
        return True

    def _obey(self, timeout_ms: int) -> None:
        while self._socket.poll(timeout_ms):
            kind, body = self._socket.recv_multipart()
            values = messages.unpack(body)
            if kind == messages.STOP:
                self._stopped = True
            elif kind == messages.GO and not self._started:
                self._started = True
                if values["position"] is not None:
                    self._source.resume(values["position"])
            timeout_ms = 0

    def _report(self, ended: bool = False) -> None:
        now = time.monotonic()
        if now < self._next_report:
            return
        self._next_report = now + REPORT_EVERY_S
        if not self._started:
            self._socket.send_multipart([messages.HELLO, messages.pack({})])
        rejected = Counters()
        rejected.merge(self._source.rejected.as_dict())
        rejected.merge(self._unsent.as_dict())
        before = self._reported.as_dict()
        new = {reason: n - before.get(reason, 0) for reason, n in rejected.as_dict().items()}
        report = {
            "rejected": {reason: n for reason, n in new.items() if n},
            "complaint": self._source.complaint,
            "details": self._details(),
            "ended": ended,
        }
        try:
            self._socket.send_multipart([messages.STATUS, messages.pack(report)], zmq.NOBLOCK)
        except zmq.Again:
            return  # with the next one
        self._reported = rejected

    def _details(self) -> dict[str, Any]:
        try:
            details: dict[str, Any] = plain(self._source.details())
            messages.pack(details)
        except Exception as error:
            log.debug("the source cannot tell its details", exc_info=True)
            return {"error": f"{type(error).__name__}: {error}"}
        return details

    def _end(self) -> None:
        """Say so until it has been heard."""
        log.info("the source has ended")
        while not self._stopped:
            self._report(ended=True)
            self._obey(int(RECV_TIMEOUT_S * 1e3))


def main() -> int:
    """Run as `python -m chachart.node.runtime.source_process`, settings on stdin."""
    settings = read_settings()
    context = zmq.Context()
    results = context.socket(zmq.PUSH)
    results.connect(settings["results"])
    told = messages.pack({"source": settings["number"]})
    first, *others = [ArrayGeometry.from_dict(array) for array in settings["arrays"]]
    try:
        cls = load_class(settings["source"]["class"])
        source = cls(cls.Settings.model_validate(settings["source"]["settings"]), first)
        source.others = tuple(others)
        source.security = SecuritySettings.model_validate(settings["security"])
        with source:
            socket = context.socket(zmq.DEALER)
            socket.set_hwm(HIGH_WATER)
            socket.setsockopt(zmq.IDENTITY, settings["identity"].encode())
            socket.connect(settings["endpoint"])
            results.send_multipart([messages.SOURCE_READY, told])
            SourceProcess(source, socket).run()
    except SetupError as error:
        message = f"source of {first.name}: {error}"
        results.send_multipart([messages.SETUP_ERROR, messages.pack({"message": message})])
        return EX_CONFIG
    finally:
        context.destroy(linger=2000)
    return 0


if __name__ == "__main__":
    sys.exit(main())
