"""A node to attack, its honest producer, and what it says of itself meanwhile."""

from __future__ import annotations

import http.client
import json
import multiprocessing
import socket as socketlib
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from typing import Any, TypeVar

from chachart.node.commands.benchmarks.attack_floods import HONEST, Ports, feed
from chachart.node.commands.benchmarks.running import RunningNode, footprints
from chachart.node.data.errors import SetupError

START_WITHIN_S, LOOK_EVERY_S = 60.0, 1.0
WARM_FRAMES = 3000
T = TypeVar("T")
SPAWN = multiprocessing.get_context("spawn")


@contextmanager
def apart(prepare: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """One process beside this one."""
    with ProcessPoolExecutor(1, SPAWN, prepare) as process:
        yield process


@dataclass(frozen=True, slots=True)
class Watched:
    """What a node did while something went on."""

    rate: float
    """Frames a second of the honest producer that got into the chart, at least."""
    pause_s: float
    """Longest time in which no frame of anybody was estimated, to a second."""
    dropped: int
    refused: int
    highest: int
    """Bytes more at the most, while it went on."""
    grown: int
    """Bytes more that stayed."""


@dataclass(frozen=True, slots=True)
class Target:
    """Ports of a node on loopback, and who feeds and watches it."""

    ports: Ports = field(default_factory=lambda: Ports(*free_ports(4)))

    def config(self) -> str:
        """The node's configuration: a `zmq` source, and every sink that listens."""
        port = asdict(self.ports)
        return f"""
            [array]
            antennas = 2
            subcarriers = 3
            subcarrier_spacing_hz = 312500.0
            [source]
            type = "zmq"
            endpoint = "tcp://127.0.0.1:{port["source"]}"
            [estimator]
            max_ues = 2000
            averaging = "mean"
            [[sinks]]
            type = "publisher"
            endpoint = "tcp://127.0.0.1:{port["charts"]}"
            [[sinks]]
            type = "control"
            endpoint = "tcp://127.0.0.1:{port["control"]}"
            [[sinks]]
            type = "view"
            port = {port["web"]}
        """

    @contextmanager
    def fed(self, node: RunningNode) -> Iterator[None]:
        """Feed it from now on; it charts when this begins."""
        feeder = SPAWN.Process(target=feed, args=(self.ports.source,), daemon=True)
        feeder.start()
        try:
            deadline = time.monotonic() + START_WITHIN_S
            while time.monotonic() < deadline:
                node.rest(0.2)
                with suppress(OSError, ValueError, KeyError, http.client.HTTPException):
                    if self.status()["frames_estimated"] > WARM_FRAMES:
                        break
            yield
        finally:
            feeder.kill()
            feeder.join()
            feeder.close()

    def status(self) -> dict[str, Any]:
        """The node's status, asked as a person on this machine would."""
        return ask(self.ports.web, "status")

    def honest(self) -> int:
        """How many frames of the honest producer are in the chart."""
        chart = ask(self.ports.web, "chart")
        frames: list[float] = [
            n for ue, n in zip(chart["ue"], chart["snapshots"], strict=True) if ue >= HONEST
        ]
        return round(sum(frames))

    def watch(self, node: RunningNode, goes_on: Future[int] | None, seconds: float) -> Watched:
        """Look at the node until that is over, `seconds` at least.

        Raises
        ------
        SetupError
            If it has ended, or charts no more.
        """
        counted, before = patiently(node, self.honest), patiently(node, self.status)
        held = held_bytes(node)
        begin = charted = time.monotonic()
        highest, pause_s, latest, honest = held, 0.0, before, 0
        while time.monotonic() < begin + seconds or (goes_on is not None and not goes_on.done()):
            node.rest(LOOK_EVERY_S)
            highest = max(highest, held_bytes(node))
            with suppress(OSError, ValueError, KeyError, http.client.HTTPException):
                status = self.status()
                if status["frames_estimated"] > latest["frames_estimated"]:
                    charted, latest = time.monotonic(), status
                honest, counted = _more(honest, counted, self.honest())
            pause_s = max(pause_s, time.monotonic() - charted)
        honest, _ = _more(honest, counted, patiently(node, self.honest))
        took = time.monotonic() - begin
        after = patiently(node, self.status)
        if not self._charts_on(node, after["frames_estimated"]):
            raise SetupError("the node charts no more")
        return Watched(
            honest / took,
            pause_s,
            sum(after["dropped"].values()) - sum(before["dropped"].values()),
            _refused(after) - _refused(before),
            highest - held,
            held_bytes(node) - held,
        )

    def _charts_on(self, node: RunningNode, estimated: int) -> bool:
        """Whether it still estimates, which may take a while."""
        deadline = time.monotonic() + START_WITHIN_S
        while patiently(node, self.status)["frames_estimated"] <= estimated:
            if time.monotonic() > deadline:
                return False
            node.rest(0.2)
        return True


def ask(web: int, what: str) -> dict[str, Any]:
    """What a node's page at this port is told: its `status`, its `chart`.

    Raises
    ------
    OSError, ValueError, http.client.HTTPException
        If it does not answer.
    """
    connection = http.client.HTTPConnection("127.0.0.1", web, timeout=30)
    try:
        connection.request("GET", f"/api/{what}")
        answer: dict[str, Any] = json.loads(connection.getresponse().read())
    finally:
        connection.close()
    return answer


def patiently(node: RunningNode, ask: Callable[[], T]) -> T:
    """The answer, also from a node that takes no connection just now.

    Raises
    ------
    SetupError
        If it answers no more.
    """
    deadline = time.monotonic() + START_WITHIN_S
    while True:
        try:
            return ask()
        except (OSError, ValueError, KeyError, http.client.HTTPException):
            if time.monotonic() > deadline:
                raise SetupError("the node answers no more") from None
            node.rest(0.2)


def _more(total: int, before: int, now: int) -> tuple[int, int]:
    """Frames in all and now; UEs that were pushed out meanwhile begin anew."""
    return total + (now - before if now >= before else now), now


def _refused(status: dict[str, Any]) -> int:
    """How many peers, requests and messages were turned away."""
    counts = [sink["refused"] for sink in status["sinks"]] + [status["source_details"]["refused"]]
    return sum(sum(reasons.values()) for reasons in [*counts, status["rejected"]])


def held_bytes(node: RunningNode) -> int:
    """Memory that all processes of a node hold."""
    return sum(footprint.bytes for footprint in footprints(node.pid).values())


def free_ports(count: int) -> list[int]:
    """So many different ports that nobody listens on right now."""
    with ExitStack() as held:
        probes = [held.enter_context(socketlib.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [int(probe.getsockname()[1]) for probe in probes]
