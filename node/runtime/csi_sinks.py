"""The sinks that take the CSI itself: those of the configuration, and a recording started while running."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from chachart.config.registry import sink_class
from chachart.node.data.errors import RequestError, SetupError
from chachart.node.data.facts import CaptureFacts
from chachart.node.runtime.reader import Reader
from chachart.node.runtime.sink_thread import SinkThread
from chachart.sinks.base import Sink
from chachart.sources.base import Source

log = logging.getLogger(__name__)

QUEUE_BLOCKS = 64
STOP_WITHIN_S = 10.0


class CsiSinks:
    """Opens sinks, hooks them to the reader, and closes them.

    Parameters
    ----------
    reader
        Whose `sinks` get the blocks.
    source
        Whose arrays they are, and, where it is lossless, a slow sink makes the reader wait.
    facts
        What the frames' phase and delay mean, as `CaptureFacts.as_dict`.
    """

    def __init__(self, reader: Reader, source: Source, facts: dict[str, Any]) -> None:
        self._reader = reader
        self._array = source.array
        self._others = source.others
        self._lossless = source.lossless
        self._facts = CaptureFacts.from_dict(facts)
        self._recording: SinkThread | None = None
        self._closed = False
        self._lock = threading.Lock()

    def add(self, cls: type[Sink], settings: dict[str, Any]) -> SinkThread:
        """Open a sink; it gets every block from now on.

        Raises
        ------
        SetupError
            If it cannot be opened.
        """
        values = cls.Settings.model_validate(settings)
        sink = cls(values, self._array)
        sink.others, sink.facts = self._others, self._facts
        thread = SinkThread(sink, values.type, QUEUE_BLOCKS, self._lossless)
        thread.open(None)
        self._reader.sinks = (*self._reader.sinks, thread)
        log.info("%s: %s", thread.name, thread.where())
        return thread

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out `start_recording` {path, compression} or `stop_recording`: {result} or {error}."""
        operation = request["operation"]
        try:
            if operation == "start_recording":
                return {"result": self.start_recording(**request["arguments"])}
            return {"result": self.stop_recording()}
        except RequestError as error:
            return {"error": str(error)}
        except Exception as error:
            log.exception("%s failed", operation)
            return {"error": f"{operation} failed: {error}"}

    def start_recording(self, path: str, compression: str) -> dict[str, Any]:
        """Record to that file from now on; gives what `recorder` tells about itself.

        Raises
        ------
        RequestError
            If a recording runs already, nothing more is read, or the file cannot be written.
        """
        with self._lock:
            if self._closed:
                raise RequestError("the node is draining: there is nothing more to record")
            if self._recording is not None:
                raise RequestError(f"already recording to {self._recording.where()}")
            try:
                made = {"type": "recorder", "path": path, "compression": compression}
                self._recording = self.add(sink_class("recorder"), made)
            except (SetupError, ValueError) as error:
                raise RequestError(str(error).splitlines()[0]) from None
            return {"on": True, **self._recording.status()}

    def stop_recording(self) -> dict[str, Any]:
        """Close the recording that `start_recording` began.

        Raises
        ------
        RequestError
            If none runs.
        """
        with self._lock:
            recording, self._recording = self._recording, None
            if recording is None:
                raise RequestError("no recording is running")
            self._reader.sinks = tuple(s for s in self._reader.sinks if s is not recording)
            recording.close(STOP_WITHIN_S)
            return {"on": False, **recording.status()}

    def status(self) -> list[dict[str, Any]]:
        """Counts for the node's status report."""
        return [sink.status() for sink in self._reader.sinks]

    def recording(self) -> str | None:
        """Where a recording started by request goes, if one runs."""
        recording = self._recording
        return None if recording is None else recording.where()

    def close(self, timeout: float, meanwhile: Callable[[], bool]) -> None:
        """Let all sinks finish what waits, then close them; none is added.

        Each gives up after `timeout` seconds; where `meanwhile`, which is called again and again, says that
        there is time, so long after it has last got on.
        """
        with self._lock:
            self._closed = True
        for sink in self._reader.sinks:
            sink.close(timeout, meanwhile)
