"""Workers on a Ray cluster: Ray decides where each runs, frames come to them by ZeroMQ over TCP.

Needs the extra `ray`; nothing else of chachart imports this.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures import wait as wait_for
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayActorError, RayError

from chachart.config.settings import WorkersSettings
from chachart.node.data.errors import SetupError
from chachart.node.net.keys import NODE, KeyPair, allow, load_public, new_pair
from chachart.node.runtime.ray_host import ChartWorker
from chachart.node.runtime.worker_pool import WorkerPool

log = logging.getLogger(__name__)

KNOCK_WITHIN_S = 5.0
OBJECT_STORE_BYTES = 128 * 2**20
"""Of a cluster of this machine alone: frames do not go through it."""
FAILED = 70
"""Exit status (EX_SOFTWARE) of a worker that could not even be started where Ray put it."""
_ACTOR: Any = ray.remote(ChartWorker)
_OWN_NAMES = {"CPU": "num_cpus", "GPU": "num_gpus", "memory": "memory"}
"""Resources that Ray has options of their own for."""


class RayPool(WorkerPool):
    """Each worker is run by an actor, which Ray places by the resources that it asks for.

    Whoever connects to the feeder needs a key, which is made for this run and given to the actors.

    Parameters
    ----------
    settings
        `[workers]`, with the cluster's address; without one a cluster of this machine is started.
    name
        What the dashboard calls the node: its array.
    private
        A folder that nobody else may look into.

    Raises
    ------
    SetupError
        If there is no such cluster.
    """

    def __init__(self, settings: WorkersSettings, name: str, private: Path) -> None:
        self._name = name
        self._namespace = private.name
        self._lives = 0
        self._options: dict[str, Any] = {"num_cpus": 0}
        self._options |= {_OWN_NAMES[k]: n for k, n in settings.resources.items() if k in _OWN_NAMES}
        self._options["resources"] = {k: n for k, n in settings.resources.items() if k not in _OWN_NAMES}
        self._connected = not ray.is_initialized()
        if self._connected:
            _connect(settings)
        _look_for(settings.resources)
        address = ray.util.get_node_ip_address()
        self.endpoint = f"tcp://{address}:{_free_port(address)}"
        self.keys = private / "keys"
        server, _ = new_pair(self.keys, NODE)
        client, secret = new_pair(self.keys, "worker")
        allow(self.keys, client, "send")
        pair = KeyPair.load(secret)
        self._curve = {
            "public": pair.public.decode(),
            "secret": pair.secret.decode(),
            "server": load_public(server).decode(),
        }

    def start(self, shard: int, settings: dict[str, Any]) -> RayChild:
        self._lives += 1
        name = f"{self._name} worker {shard}"
        options = {"name": f"{name}, start {self._lives}", "namespace": self._namespace, **self._options}
        try:
            return RayChild(name, {**settings, "curve": self._curve}, options)
        except RayError as error:
            raise OSError(str(error)) from error

    def close(self) -> None:
        if self._connected:
            ray.shutdown()


class RayChild:
    """A worker that an actor runs; see `Child`. Its process id is known once it has said hello."""

    def __init__(self, name: str, settings: dict[str, Any], options: dict[str, Any]) -> None:
        self.name = name
        self.pid = 0
        self.last_error: str | None = None
        self._code: int | None = None
        self._actor = _ACTOR.options(**options).remote(name)
        self._ended: Future[tuple[int, str | None]] = self._actor.run.remote(settings).future()

    def exit_code(self) -> int | None:
        if self._code is None and self._ended.done():
            try:
                self._code, self.last_error = self._ended.result()
            except RayActorError:  # the actor was killed, or its machine is gone
                self._code = -signal.SIGKILL
            except RayError as error:
                self._code, self.last_error = FAILED, str(error)
                log.error("%s: %s", self.name, error)
        return self._code

    def wait(self, timeout: float | None = None) -> bool:
        return bool(wait_for([self._ended], timeout).done)

    def kill(self) -> None:
        """End the actor, which takes the worker with it."""
        try:
            ray.kill(self._actor)
        except RayError as error:
            log.warning("%s cannot be killed: %s", self.name, error)

    def close(self, timeout: float = 1.0) -> None:
        self.wait(timeout)
        self.kill()


def _connect(settings: WorkersSettings) -> None:
    """Join the cluster, or start one.

    Raises
    ------
    SetupError
        If it cannot be joined.
    """
    options: dict[str, Any] = {"address": settings.address}
    if settings.address is None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nobody is told of it
        options = {"address": "local", "num_cpus": max(os.cpu_count() or 1, settings.count)}
        options["object_store_memory"] = OBJECT_STORE_BYTES
    with _signals_left_alone():
        try:
            _knock(settings.address)
            ray.init(**options, log_to_driver=False, configure_logging=False)
        except (RuntimeError, ValueError, OverflowError, OSError, RayError) as error:
            reason = str(error).partition("\n")[0][:300]
            raise SetupError(f"[workers]: no Ray cluster at address {settings.address!r}: {reason}") from None


def _knock(address: str | None) -> None:
    """Make sure that somebody listens at a `host:port`: Ray tries for minutes."""
    host, _, port = (address or "").rpartition(":")
    if host and port.isdigit() and "/" not in host:
        socket.create_connection((host, int(port)), KNOCK_WITHIN_S).close()


@contextmanager
def _signals_left_alone() -> Iterator[None]:
    """Ray ends the process at SIGTERM, a node drains."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _look_for(resources: dict[str, float]) -> None:
    """Say which resources there is no machine with, which an autoscaler may mend."""
    there = ray.cluster_resources()
    for name, amount in resources.items():
        if there.get(name, 0.0) < amount:
            log.warning("no machine of the Ray cluster has %g %s: workers wait for one", amount, name)


def _free_port(address: str) -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as free:
        free.bind((address, 0))
        port: int = free.getsockname()[1]
        return port
