"""Whatever is killed whenever: the chart is the one that an undisturbed run gives."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fsspec
import outage
import pytest
from node_runs import ARRAY, DEADLINE_S, Running, adds_up, assert_same_chart, undisturbed, until

from chachart.config.settings import QualitySettings, StateSettings, WorkersSettings
from chachart.node.estimation.options import Options
from chachart.node.runtime.node import Node
from chachart.node.runtime.plan import Plan
from chachart.node.runtime.supervisor import STILLBORN_LIMIT
from chachart.sources.recording import Recording, RecordingSettings
from chachart.sources.simulator import Simulator, SimulatorSettings

AFTER = 8000
"""Frames between disturbances. The capture is played for ever, so that none of them comes too late."""

MakeNode = Callable[..., Node]
RunNode = Callable[..., Running]


@pytest.fixture
def make_node(capture: Path) -> Iterator[MakeNode]:
    """Nodes on the capture at 20 000 frames/s; what still runs is killed."""
    nodes = []

    def make(count: int = 2, source: Any = None, **state: Any) -> Node:
        source = source or (Recording, RecordingSettings(path=capture, speed=20, loops=0))
        node = Node(
            Plan(
                ARRAY,
                *source,
                Options(averaging="mean"),
                WorkersSettings(count=count, block_frames=16),
                QualitySettings(every_s=0.2, k=5),
                StateSettings(**state),
                (),
            )
        )
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        if not node.closed:
            node.stop(0.1)
            node.close()


def stop_and_compare(node: Node) -> dict[str, Any]:
    """End it: nothing is lost, and the chart is that of an undisturbed run."""
    node.stop()
    summary = finish(node)
    assert summary["frames_in"] == summary["frames_estimated"]
    assert summary["dropped"] == {}
    assert (summary["state_lost"], summary["ues_reset"]) == (0, 0)
    assert_same_chart(node.chart(), undisturbed(summary["frames_in"]))
    return summary


def finish(node: Node) -> dict[str, Any]:
    assert node.wait(DEADLINE_S)
    assert node.failure is None
    return node.close()


def worker_pid(node: Node, shard: int) -> int:
    until(lambda: node.status()["workers"][shard]["pid"], f"worker {shard} is there")
    pid: int = node.status()["workers"][shard]["pid"]
    return pid


def reached(node: Node, frames: int) -> None:
    until(lambda: node.status()["frames_estimated"] >= frames, f"{frames} frames are estimated")


def goes_on(node: Node) -> None:
    reached(node, node.status()["frames_estimated"] + AFTER)


@pytest.mark.parametrize(("count", "every_s"), [(1, 0.1), (2, 60.0)])
def test_workers(make_node: MakeNode, count: int, every_s: float) -> None:
    node = make_node(count, every_s=every_s)
    node.start()
    for kill in range(3):
        goes_on(node)
        os.kill(worker_pid(node, kill % count), signal.SIGKILL)
        until(
            lambda k=kill: sum(w["restarts"] for w in node.status()["workers"]) == k + 1,
            "there is a successor",
        )
    assert stop_and_compare(node)["worker_restarts"] == 3


@pytest.mark.parametrize("count", [1, 2])
def test_the_feeder(make_node: MakeNode, count: int) -> None:
    node = make_node(count, every_s=0.3)
    node.start()
    for kill in range(2):
        goes_on(node)
        os.kill(node.feeder_pid, signal.SIGKILL)
        until(lambda k=kill: node.status()["feeder_restarts"] == k + 1, "there is a successor")
    stop_and_compare(node)


def test_the_feeder_and_a_worker_at_once(make_node: MakeNode) -> None:
    node = make_node(2, every_s=0.3)
    node.start()
    goes_on(node)
    for pid in (worker_pid(node, 0), node.feeder_pid):
        os.kill(pid, signal.SIGKILL)
    until(lambda: node.status()["feeder_restarts"] == 1, "the feeder has a successor")
    goes_on(node)
    stop_and_compare(node)


def test_a_worker_soon_after_the_feeder(make_node: MakeNode) -> None:
    node = make_node(2, every_s=60.0)
    node.start()
    goes_on(node)
    os.kill(node.feeder_pid, signal.SIGKILL)
    until(lambda: node.status()["feeder_restarts"] == 1, "there is a successor")
    goes_on(node)
    os.kill(worker_pid(node, 1), signal.SIGKILL)
    goes_on(node)
    stop_and_compare(node)


def test_everything_and_then_resumed_with_more_workers(
    run_node: RunNode, make_node: MakeNode, capture: Path, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    first = run_node(
        f"""
        [source]
        type = "recording"
        path = "{capture}"
        speed = 20
        loops = 0
        [estimator]
        averaging = "mean"
        [workers]
        count = 2
        block_frames = 16
        [state]
        directory = "local://{state}"
        every_s = 0.2
        """,
        "--resume",
    )
    until(lambda: len(list(state.glob("*/worker-*-of-2-*.snapshot"))) == 4, "snapshots are written")
    first.signal(signal.SIGKILL)
    first.finish()
    assert "nothing" in first.said()
    tear_newest(state)
    node = make_node(3, every_s=0.2, directory=state.as_uri(), resume=True)
    node.start()
    assert node.chart() is None or len(node.chart()) <= 40  # type: ignore[arg-type]
    goes_on(node)
    stop_and_compare(node)

    for count in (3, 2):
        again = make_node(count, every_s=0.2, directory=f"local://{state}", resume=True)
        again.start()
        goes_on(again)
        stop_and_compare(again)


def test_snapshots_out_of_reach_are_waited_for(make_node: MakeNode, network: Path, tmp_path: Path) -> None:
    """A worker that cannot read what was learnt does not begin with nothing, and says why."""
    node = make_node(2, every_s=0.2, directory=f"outage://{tmp_path}/state")
    node.start()
    goes_on(node)
    network.unlink()
    os.kill(worker_pid(node, 0), signal.SIGKILL)
    until(lambda: "worker 0 cannot read" in (node.status()["reason"] or ""), "it is told")
    told = node.status()
    assert (told["state"], told["reason"]) == (
        "degraded",
        f"worker 0 cannot read its snapshots: outage://{tmp_path}/state/{next(tmp_path.glob('state/run-*')).name}"
        " is out of reach: the network is down",
    )
    assert "[state] directory" in told["fix"]
    until(lambda: node.status()["workers"][0]["restarts"] > STILLBORN_LIMIT, "it is tried again and again")
    network.touch()
    goes_on(node)
    stop_and_compare(node)


@pytest.fixture
def network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file that is there while outage: URLs can be reached; their driver is found as any other is."""
    package = tmp_path / "outage-1.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: outage\nVersion: 1\n")
    (package / "entry_points.txt").write_text("[fsspec.specs]\noutage = outage:Outage\n")
    helpers = str(Path(outage.__file__).parent)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{helpers}")
    fsspec.register_implementation("outage", outage.Outage, clobber=True)
    up = tmp_path / "up"
    monkeypatch.setenv(outage.UP, str(up))
    up.touch()
    return up


def tear_newest(state: Path) -> None:
    """Cut the newest snapshot of one worker and of the main process, as a power cut does."""
    for series in ("worker-0-of-2", "node"):
        newest = max(state.glob(f"*/{series}-*.snapshot"))
        newest.write_bytes(newest.read_bytes()[: newest.stat().st_size // 2])


@pytest.fixture
def make_live(make_node: MakeNode, monkeypatch: pytest.MonkeyPatch) -> MakeNode:
    """The same nodes with a source that does not wait."""

    def make(**state: Any) -> Node:
        live = SimulatorSettings(type="simulator", layout="uniform", ues=40, frame_rate_hz=2000.0)
        return make_node(1, (Simulator, live), **state)

    return make


@pytest.mark.parametrize("victim", ["worker", "feeder"])
def test_a_live_source_goes_on_and_what_cannot_be_had_again_is_counted(
    make_live: MakeNode, victim: str
) -> None:
    node = make_live(every_s=0.3)
    node.start()
    reached(node, 2000)
    pid = worker_pid(node, 0) if victim == "worker" else node.feeder_pid
    os.kill(pid, signal.SIGKILL)
    frames = node.status()["frames_estimated"]
    reached(node, frames + 2000)
    node.stop()
    summary = finish(node)
    assert adds_up(summary)
    assert set(summary["dropped"]) <= {"feeder_lost", "queue_full"}
    assert (summary["state_lost"], summary["ues_reset"]) == (0, 0)
    chart = node.chart()
    assert chart is not None
    assert (chart.snapshots > 30).all(), "what was learnt goes on"


def test_without_snapshots_what_is_lost_is_told(make_live: MakeNode) -> None:
    node = make_live(every_s=0)
    node.start()
    reached(node, 2000)
    os.kill(worker_pid(node, 0), signal.SIGKILL)
    until(lambda: node.status()["state_lost"], "it is told")
    assert node.status()["ues_reset"] == 40
    node.stop()
    summary = finish(node)
    assert adds_up(summary)
    assert summary["state_lost"] >= 2000


@pytest.mark.parametrize("victim", ["worker", "feeder"])
def test_what_hangs_is_noticed_and_succeeded(make_node: MakeNode, victim: str) -> None:
    node = make_node(2, every_s=0.5)
    node.start()
    goes_on(node)
    os.kill(worker_pid(node, 1) if victim == "worker" else node.feeder_pid, signal.SIGSTOP)
    restarts = (
        (lambda: node.status()["workers"][1]["restarts"])
        if victim == "worker"
        else (lambda: node.status()["feeder_restarts"])
    )
    until(restarts, "it has a successor")
    goes_on(node)
    summary = stop_and_compare(node)
    assert (summary["worker_restarts"], summary["feeder_restarts"]) == (
        (1, 0) if victim == "worker" else (0, 1)
    )
