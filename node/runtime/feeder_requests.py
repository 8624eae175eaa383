"""What the feeder does when it is asked for something."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from chachart.node.data.errors import RequestError
from chachart.node.runtime import messages
from chachart.node.runtime.antenna_looks import AntennaLooks
from chachart.node.runtime.csi_sinks import CsiSinks
from chachart.node.runtime.partition import shard_of
from chachart.node.runtime.worker_links import WorkerLinks
from chachart.sources.base import Source

log = logging.getLogger(__name__)


@dataclass(slots=True)
class Terms:
    """What new blocks are sent with: (theta, rho), and how often the source has jumped in time."""

    method: tuple[str, str]
    round: int = 0


class FeederRequests:
    """Carries out requests: {id, operation, arguments} in, {id, result} or {id, error} out.

    Parameters
    ----------
    terms, source, antennas, csi_sinks, links
        Whom they are about.
    reply
        Takes answers.
    wake
        Makes the dispatcher call `reply_to_slow_ones`; may be called from any thread.
    """

    def __init__(
        self,
        terms: Terms,
        source: Source,
        antennas: AntennaLooks,
        csi_sinks: CsiSinks,
        links: WorkerLinks,
        reply: Callable[[dict[str, Any]], None],
        wake: Callable[[], None],
    ) -> None:
        self._terms = terms
        self._source = source
        self._antennas = antennas
        self._csi_sinks = csi_sinks
        self._links = links
        self._reply = reply
        self._wake = wake
        self._slow: deque[dict[str, Any]] = deque()

    def handle(self, request: dict[str, Any]) -> None:
        """Carry it out, or pass it on to the worker that has the UE."""
        operation, arguments = request["operation"], request["arguments"]
        if operation == "set_method":
            self._terms.method = (arguments["theta"], arguments["rho"])
            self._reply({"id": request["id"], "result": arguments})
        elif operation in ("start_recording", "stop_recording"):
            threading.Thread(target=self._record, args=(request,), name="record", daemon=True).start()
        elif operation == "antennas":
            self._reply({"id": request["id"], "result": self._antennas.of_ue(arguments["ue"])})
        elif operation == "replay":
            self._replay(request)
        else:
            shard = int(shard_of(np.array([arguments["ue"]], np.uint64), len(self._links.peers))[0])
            if not self._links.send(shard, messages.REQUEST, request):
                error = f"worker {shard}, which has UE {arguments['ue']}, is being restarted"
                self._reply({"id": request["id"], "error": error})

    def reply_to_slow_ones(self) -> None:
        """Send the answers that have come from other threads."""
        while self._slow:
            self._reply(self._slow.popleft())

    def _replay(self, request: dict[str, Any]) -> None:
        """Steer the source; after a jump, what workers know of UEs is of another time."""
        before, wishes = self._source.details(), request["arguments"]
        try:
            plays = self._source.replay(**wishes)
        except RequestError as error:
            self._reply({"id": request["id"], "error": str(error)})
            return
        jumped = wishes["at_s"] is not None or (before["replay"]["ended"] and not plays["ended"])
        self._terms.round += jumped
        self._reply({"id": request["id"], "result": {**plays, "jumped": jumped}})

    def _record(self, request: dict[str, Any]) -> None:
        self._slow.append({"id": request["id"], **self._csi_sinks.answer(request)})
        self._wake()
