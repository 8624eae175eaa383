"""The actor that has a worker run on whichever machine Ray has put it on.

The worker is a plain process here too, a child of the actor that ends with it: what Ray has in a process, its
threads above all, is not in the worker, which forks to write its snapshots.
"""

from __future__ import annotations

import logging
from typing import Any

from chachart.node.runtime.child import Child
from chachart.node.runtime.worker_pool import WORKER


class ChartWorker:
    """Runs one worker.

    Parameters
    ----------
    name
        What log and dashboard call it.
    """

    def __init__(self, name: str) -> None:
        logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
        self._name = name

    def __repr__(self) -> str:
        return self._name

    def run(self, settings: dict[str, Any]) -> tuple[int, str | None]:
        """Start the worker and wait for its end: its exit code, and the last error that it logged."""
        child = Child(self._name, WORKER, {**settings, "directory": None})
        child.wait()
        child.close()
        code = child.exit_code()
        assert code is not None
        return code, child.last_error
