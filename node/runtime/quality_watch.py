"""Works out how good the chart is, every few seconds, in a process that yields to everything else.

Not in a thread: one that holds the interpreter while it waits for its turn would hold up the estimates too.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import zmq

from chachart.config.settings import QualitySettings
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import RequestError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.quality import assess
from chachart.node.runtime import messages
from chachart.node.runtime.child import Child, read_settings
from chachart.node.runtime.supervisor import DEATHS_WINDOW_S

log = logging.getLogger(__name__)

FEWEST_UES = 4
"""With fewer, no figure means anything."""
MOST_OF_TIME = 0.25
"""Share of the time that may go into quality, however long one report takes."""
REPORT_WITHIN_S = 60.0
POLL_S = 0.1
MOST_DEATHS = 3


class QualityWatch:
    """Reports on the chart while it runs, and once more at the end.

    Parameters
    ----------
    settings
        `[quality]`.
    chart
        Gives the chart as it stands.
    publish
        Takes each report.
    start
        Starts the process that assesses, once there is something to assess.
    endpoint
        Where that process connects.

    Attributes
    ----------
    latest
        The latest report.
    failure
        That the process died too often, or None.
    """

    def __init__(
        self,
        settings: QualitySettings,
        chart: Callable[[], ChartUpdate | None],
        publish: Callable[[dict[str, Any]], None],
        start: Callable[[], Child],
        endpoint: str,
    ) -> None:
        self.latest: dict[str, Any] | None = None
        self.failure: str | None = None
        self._deaths: deque[float] = deque(maxlen=MOST_DEATHS)
        self._settings = settings
        self._chart = chart
        self._publish = publish
        self._start = start
        self._endpoint = endpoint
        self._child: Child | None = None
        self._reports = 0
        self._finishing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="quality", daemon=True)

    def start(self) -> None:
        """Begin to report."""
        self._thread.start()

    def finish(self) -> None:
        """Report one last time on the whole chart, and end."""
        self._finishing.set()
        if self._thread.ident is not None:
            self._thread.join()

    def kill(self) -> None:
        """End the process now."""
        self._finishing.set()
        if self._child is not None:
            self._child.kill()

    def _run(self) -> None:
        with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
            socket.linger = 0
            socket.bind(self._endpoint)
            wait = self._settings.every_s
            while not self._finishing.wait(wait):
                started = time.monotonic()
                self._report(socket)
                wait = max(self._settings.every_s, (time.monotonic() - started) / MOST_OF_TIME)
            self._report(socket)
            if self._child is not None:
                socket.send_multipart([messages.END])
                self._child.close()

    def _report(self, socket: zmq.Socket[bytes]) -> None:
        chart = self._chart()
        if chart is None or chart.position is None:
            return
        known = np.flatnonzero(np.isfinite(chart.position).all(axis=1))
        if len(known) < FEWEST_UES:
            return
        try:
            report = self._ask(socket, chart.take(known))
        except RequestError as error:
            log.warning("no quality report: %s", error)
            return
        self.latest = report
        self._publish(report)

    def _ask(self, socket: zmq.Socket[bytes], chart: ChartUpdate) -> dict[str, Any]:
        if self._child is None:
            self._child = self._start()
        self._reports += 1
        question = {"id": self._reports, "k": self._settings.k, "exact_ues": self._settings.exact_ues}
        deadline = time.monotonic() + REPORT_WITHIN_S
        self._await(socket, zmq.POLLOUT, self._child, deadline)
        socket.send_multipart([messages.REQUEST, messages.pack(question), messages.pack_update(chart)])
        while True:
            self._await(socket, zmq.POLLIN, self._child, deadline)
            answer = messages.unpack(socket.recv_multipart()[1])
            if answer["id"] == self._reports:
                break
        if "error" in answer:
            raise RequestError(answer["error"])
        report: dict[str, Any] = answer["result"]
        return report

    def _await(self, socket: zmq.Socket[bytes], event: int, child: Child, deadline: float) -> None:
        """Wait until the socket is ready; a process that is dead or late is given up."""
        while not socket.poll(int(POLL_S * 1e3), event):
            if child.exit_code() is not None or time.monotonic() > deadline:
                child.kill()
                child.close()
                self._child = None
                self._count_death()
                raise RequestError("the quality process died or took too long")

    def _count_death(self) -> None:
        self._deaths.append(time.monotonic())
        if len(self._deaths) == MOST_DEATHS and self._deaths[-1] - self._deaths[0] < DEATHS_WINDOW_S:
            self.failure = f"the quality process died {MOST_DEATHS} times within a minute"


def main() -> None:
    """Run as `python -m chachart.node.runtime.quality_watch`, settings on stdin."""
    settings = read_settings()
    array = ArrayGeometry.from_dict(settings["array"])
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.connect(settings["quality"])
        while (parts := socket.recv_multipart())[0] != messages.END:
            question = messages.unpack(parts[1])
            answer: dict[str, Any] = {"id": question["id"]}
            try:
                chart = messages.unpack_update(parts[2])
                answer["result"] = assess(chart, array, question["k"], question["exact_ues"])
            except ValueError as error:
                answer["error"] = str(error)
            socket.send_multipart([messages.REPLY, messages.pack(answer)])


if __name__ == "__main__":
    main()
