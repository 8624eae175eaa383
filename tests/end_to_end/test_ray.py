"""Workers on a Ray cluster of several raylets: the chart is as it should be, whatever is killed."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pool_contract
import pytest
from node_runs import Running, assert_same_chart, undisturbed, until
from ray_cluster import RayCluster

from chachart.node.commands.ctl import ask
from chachart.node.data.errors import EX_CONFIG
from chachart.node.files.chart_log import ChartLogReader
from chachart.node.runtime.child import LACKS

AFTER = 3000
"""Frames between disturbances."""


@pytest.fixture(scope="module")
def cluster() -> Iterator[RayCluster]:
    """A head that has room for three workers."""
    with RayCluster(cpus=3) as made:
        yield made


@pytest.fixture
def on_ray(cluster: RayCluster, monkeypatch: pytest.MonkeyPatch) -> RayCluster:
    for name in ("RAY_AUTH_MODE", "RAY_USAGE_STATS_ENABLED"):
        monkeypatch.setenv(name, cluster.environment[name])
    return cluster


class OnRay:
    """A node on the capture, played for ever, with workers on the cluster."""

    def __init__(self, run: Callable[..., Running], capture: Path, folder: Path, workers: str) -> None:
        self.control, self.log = f"ipc://{folder}/control", folder / "chart.mcap"
        self.running = run(
            f"""
            [source]
            type = "recording"
            path = "{capture}"
            speed = 5
            loops = 0
            [estimator]
            averaging = "mean"
            [workers]
            count = 2
            block_frames = 16
            runtime = "ray"
            {workers}
            [state]
            every_s = 0.5
            [[sinks]]
            type = "control"
            endpoint = "{self.control}"
            [[sinks]]
            type = "chart_log"
            path = "{self.log}"
            every_s = 0
            """
        )

    def status(self) -> dict[str, Any]:
        return ask(self.control, {"op": "status"}, 30.0)

    def goes_on(self) -> None:
        estimated = self.status()["frames_estimated"]
        until(lambda: self.status()["frames_estimated"] >= estimated + AFTER, "frames are estimated")

    def stop_and_compare(self) -> dict[str, Any]:
        self.running.signal(signal.SIGTERM)
        assert self.running.finish() == 0, self.running.said()
        summary = self.running.summary()
        assert summary["frames_in"] == summary["frames_estimated"]
        assert (summary["dropped"], summary["state_lost"], summary["ues_reset"]) == ({}, 0, 0)
        assert_same_chart(ChartLogReader(self.log).chart(), undisturbed(summary["frames_in"]), logged=True)
        return summary


def actor_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


pytestmark = pytest.mark.timeout(300)


@pytest.mark.parametrize("runtime", ["processes", "ray"])
def test_what_a_pool_does(on_ray: RayCluster, runtime: str) -> None:
    program = Path(pool_contract.__file__)
    tried = subprocess.run(
        [sys.executable, str(program), runtime, on_ray.address], capture_output=True, text=True, timeout=100
    )
    assert tried.returncode == 0, tried.stderr
    assert json.loads(tried.stdout.splitlines()[-1]) == {
        "strangers": False,
        "while it runs": None,
        "at the end": 0,
        "killed": -signal.SIGKILL,
        "lacking": LACKS,
        "what": "/there/is/no/such/folder is out of reach: it is not there, as seen from this worker",
    }


def test_a_cluster_that_is_not_there_is_told(run_node: Callable[..., Running], on_ray: RayCluster) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
    node = run_node(
        f"""
        source = {{ type = "simulator" }}
        array = {{ antennas = 4, subcarriers = 4, subcarrier_spacing_hz = 312500.0 }}
        workers = {{ runtime = "ray", address = "{address}" }}
        """
    )
    assert node.finish() == EX_CONFIG
    assert (
        node.said() == f"[workers]: no Ray cluster at address {address!r}: [Errno 111] Connection refused\n"
    )


def test_the_chart_is_that_of_one_process_whatever_is_killed(
    on_ray: RayCluster, run_node: Callable[..., Running], capture: Path, tmp_path: Path
) -> None:
    node = OnRay(run_node, capture, tmp_path, f'address = "{on_ray.address}"\nresources = {{ rack = 1.0 }}')
    on_ray.tell("add", "one")
    on_ray.tell("add", "two")
    until(lambda: Path(node.control.removeprefix("ipc://")).exists(), "it answers")
    node.goes_on()
    pid = node.status()["workers"][0]["pid"]
    assert "ChartWorker" in Path(f"/proc/{actor_of(pid)}/cmdline").read_text(), "its name says what it is"
    os.kill(actor_of(pid), signal.SIGKILL)
    until(lambda: node.status()["workers"][0]["restarts"] == 1, "the actor is missed")
    node.goes_on()
    until(lambda: node.status()["workers"][0]["pid"] not in (None, pid), "there is another worker")
    os.kill(node.status()["feeder_pid"], signal.SIGKILL)
    until(lambda: node.status()["feeder_restarts"] == 1, "the feeder is missed")
    node.goes_on()
    on_ray.tell("kill", "two")
    until(lambda: sum(w["restarts"] for w in node.status()["workers"]) >= 2, "the raylet is missed")
    on_ray.tell("add", "three")
    until(lambda: all(w["pid"] for w in node.status()["workers"]), "all have a place again")
    node.goes_on()
    node.stop_and_compare()
