"""Where workers run: processes of this machine, or of any machine of a Ray cluster.

Whatever the pool, a worker is the same plain process. It gets its settings as JSON, its frames by ZeroMQ, and
what it had learnt from the snapshots of the one before it; the supervisor succeeds one that died.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from chachart.config.settings import WorkersSettings
from chachart.node.data.extras import require
from chachart.node.runtime.child import Child, ChildProcess
from chachart.node.runtime.links import Links

WORKER = "chachart.node.runtime.worker"


class WorkerPool(ABC):
    """Starts workers.

    Attributes
    ----------
    endpoint
        Where the feeder listens for workers.
    keys
        Folder of the keys that the feeder's end asks for; None where nobody else can reach it.
    """

    endpoint: str
    keys: Path | None = None

    @abstractmethod
    def start(self, shard: int, settings: dict[str, Any]) -> ChildProcess:
        """Start a worker for `shard`; it connects once it runs.

        Raises
        ------
        OSError
            If none can be started just now.
        """

    def close(self) -> None:
        """Let go of everything, when all workers have ended."""


class ProcessPool(WorkerPool):
    """Workers are children of the main process.

    Parameters
    ----------
    endpoint
        A Unix socket in the node's private folder.
    """

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint

    def start(self, shard: int, settings: dict[str, Any]) -> ChildProcess:
        return Child(f"worker {shard}", WORKER, {**settings, "curve": None})


def make_pool(settings: WorkersSettings, name: str, links: Links) -> WorkerPool:
    """The pool that `[workers]` asks for.

    Parameters
    ----------
    settings
        `[workers]`.
    name
        What people call the node: its array.
    links
        The main process's sockets, in a folder that nobody else may look into.

    Raises
    ------
    SetupError
        If Ray is not installed, or there is no such cluster.
    """
    if settings.runtime == "processes":
        return ProcessPool(links.endpoints["workers"])
    require("ray", '[workers] runtime = "ray":')
    from chachart.node.runtime.ray_pool import RayPool  # which is loaded by nobody who does without Ray

    return RayPool(settings, name, links.directory)
