"""A Ray cluster of several raylets on this machine, in a process of its own, which this is where it is run.

Lines in: `add NAME` (a raylet with room for one worker that asks for a `rack`), `kill NAME` (SIGKILL it and
what it runs).
Lines out: the cluster's address, and then one for each line in, when it is done.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Self

import pytest

SMALL: dict[str, Any] = {"object_store_memory": 80 * 2**20, "include_dashboard": False}

HEALTH = {
    "health_check_initial_delay_ms": 500,
    "health_check_period_ms": 500,
    "health_check_failure_threshold": 6,
}
"""A raylet that was killed is missed after three seconds."""


class RayCluster:
    """The cluster as tests use it. Tests skip without Ray, but fail where CHACHART_CI is set."""

    def __init__(self, cpus: int) -> None:
        if find_spec("ray") is None:
            if os.environ.get("CHACHART_CI"):
                pytest.fail("ray is not installed")
            pytest.skip("ray is not installed")
        # A short path, for sockets; and no file of Ray's in anybody's home.
        self.folder = Path(tempfile.mkdtemp(prefix="ray-", dir="/tmp"))
        self.environment = {**os.environ, "RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0"}
        head = {"num_cpus": cpus, "temp_dir": str(self.folder), "_system_config": HEALTH, **SMALL}
        self._process = subprocess.Popen(
            [sys.executable, __file__, json.dumps(head)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=self.environment,
            text=True,
            start_new_session=True,
        )
        self.address = self._answer()

    def tell(self, *words: str) -> None:
        """Send a line, and wait until it is done."""
        assert self._process.stdin is not None
        self._process.stdin.write(" ".join(words) + "\n")
        self._process.stdin.flush()
        self._answer()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(60)
        self._process.stdout.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _answer(self) -> str:
        assert self._process.stdout is not None
        while line := self._process.stdout.readline():
            if line.startswith("= "):
                return line[2:].strip()
        raise AssertionError("the cluster's process has ended")


def main() -> None:
    """Be the cluster's process until stdin ends."""
    from ray.cluster_utils import Cluster

    head = json.loads(sys.argv[1])
    cluster = Cluster(initialize_head=True, head_node_args=head)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    print("=", cluster.address, flush=True)
    raylets = {}
    for line in sys.stdin:
        what, name = line.split()
        if what == "add":
            raylets[name] = cluster.add_node(num_cpus=1, resources={"rack": 1.0}, **SMALL)
        else:
            cluster.remove_node(raylets.pop(name), allow_graceful=False)
        print("=", what, name, flush=True)
    cluster.shutdown()


if __name__ == "__main__":
    main()
