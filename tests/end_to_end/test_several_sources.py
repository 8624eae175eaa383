"""A node with several sources: one chart, and whatever becomes of one source happens to no other."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from node_runs import DEADLINE_S, until
from raytraced_archives import write_archive

from chachart.config.load import settings_of
from chachart.node.commands.main import main
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.files.recording import RecordingReader, RecordingWriter
from chachart.node.net.wire import encode_csi
from chachart.node.runtime.node import Node
from chachart.node.runtime.plan import Plan

MakeNode = Callable[..., Node]
FRAMES = 2 * 30 * 3


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """What three arrays recorded of two UEs that walk, a file an array."""
    folder = tmp_path_factory.mktemp("hall")
    archive = write_archive(folder / "walk.npz")
    assert main(["import", str(archive), str(folder / "all.mcap"), "--snr-db", "10", "--seed", "1"]) == 0
    reader = RecordingReader(folder / "all.mcap")
    paths = []
    for array in reader.arrays:
        paths.append(folder / f"{array.name}.mcap")
        with RecordingWriter(paths[-1], array, note=reader.note, facts=reader.facts) as writer:
            seq = 0
            for block in reader.blocks():
                if block.array == array.name:
                    writer.write(replace(block, seq=seq))
                    seq += len(block)
    return paths


@pytest.fixture
def make_node() -> Iterator[MakeNode]:
    """Nodes that track; what still runs is ended."""
    nodes: list[Node] = []

    def make(document: dict[str, Any], *changes: str) -> Node:
        settings = settings_of(document, ["tracking.motion=walk", *changes], "test")
        nodes.append(Node(Plan.of(settings)))
        return nodes[-1]

    yield make
    for node in nodes:
        if not node.closed:
            node.stop(0.1)
            node.close()


def _played(paths: list[Path], speed: float) -> dict[str, Any]:
    return {"source": [{"type": "recording", "path": str(path), "speed": speed} for path in paths]}


def _assert_right(node: Node) -> dict[str, Any]:
    assert node.wait(DEADLINE_S)
    chart = node.chart()
    summary = node.close()
    assert node.failure is None
    assert summary["frames_in"] == summary["frames_estimated"] == FRAMES
    assert summary["gaps"] == summary["out_of_order"] == 0
    assert chart is not None
    assert chart["arrays"].tolist() == [3, 3]
    truth = chart["position"]
    np.testing.assert_allclose(np.column_stack([chart.x, chart.y]), truth[:, :2], atol=0.3)
    return summary


def test_recordings_of_one_array_each_become_one_chart(make_node: MakeNode, recordings: list[Path]) -> None:
    node = make_node(_played(recordings, 0), "workers.count=2")
    node.start()
    _assert_right(node)
    sources = node.status()["sources"]
    assert [source["frames"] for source in sources] == [FRAMES // 3] * 3
    assert all(source["ended"] for source in sources)


def test_a_killed_source_process_goes_on_where_it_was(make_node: MakeNode, recordings: list[Path]) -> None:
    node = make_node(_played(recordings, 2), "tracking.motion=off")
    node.start()
    for number in (0, 2):
        until(lambda: node.status()["frames_in"] > 0, "frames come")
        pid = node.status()["sources"][number]["pid"]
        if pid is not None:
            os.kill(pid, signal.SIGKILL)
    summary = _assert_right(node)
    assert summary["feeder_restarts"] == 0


class Producers:
    """Somebody who sends the recordings' frames to ZeroMQ sources, over and over, at this host's time."""

    def __init__(self, node: Node, recordings: list[Path]) -> None:
        self.sent = [0] * len(recordings)
        self._blocks = [CsiBlock.concatenate(list(RecordingReader(path).blocks())) for path in recordings]
        self._node = node
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Producers:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        context = zmq.Context()
        sockets = []
        for source in self._node.status()["sources"]:
            socket = context.socket(zmq.PUSH)
            socket.set_hwm(4)
            socket.connect(source["details"]["endpoint"])
            sockets.append(socket)
        n = 0
        while not self._stop.wait(0.02):
            now = np.full(2, time.time_ns())
            for i, (socket, block) in enumerate(zip(sockets, self._blocks, strict=True)):
                at = (2 * n) % len(block)
                part = replace(block.cut(at, at + 2), seq=self.sent[i], time_ns=now)
                try:
                    socket.send_multipart(encode_csi(part), zmq.NOBLOCK)
                except zmq.Again:
                    continue
                self.sent[i] += 2
            n += 1
        context.destroy(linger=0)


def _live(recordings: list[Path], tmp_path: Path) -> dict[str, Any]:
    arrays = [RecordingReader(path).array for path in recordings]
    return {
        "array": [
            {
                "name": array.name,
                "elements": [list(place) for place in array.own_elements.tolist()],
                "position_m": array.centre_m.tolist(),
                "axis": list(array.axis),
                "broadside": list(array.broadside),
                "carrier_hz": array.carrier_hz,
                "subcarriers": array.subcarriers,
                "subcarrier_spacing_hz": array.subcarrier_spacing_hz,
                "clock": "hall",
            }
            for array in arrays
        ],
        "source": [
            {"type": "zmq", "endpoint": f"ipc://{tmp_path}/{n}", "array": array.name}
            for n, array in enumerate(arrays)
        ],
    }


def test_a_live_source_that_dies_leaves_the_others_charting(
    make_node: MakeNode, recordings: list[Path], tmp_path: Path
) -> None:
    node = make_node(_live(recordings, tmp_path), "tracking.motion=off")
    node.start()
    until(lambda: all(s["details"] for s in node.status()["sources"]), "the sources tell where they listen")
    with Producers(node, recordings):
        until(lambda: node.chart() is not None and node.chart()["arrays"].min() == 3, "all three are fused")
        pid = node.status()["sources"][1]["pid"]
        os.kill(pid, signal.SIGSTOP)
        name = node.status()["sources"][1]["name"]
        until(lambda: f"array {name}: nothing for" in str(node.status()["reason"]), "it is told")
        before = node.status()["frames_estimated"]
        until(lambda: node.status()["frames_estimated"] > before + 40, "the others go on")
        until(lambda: node.chart()["arrays"].max() == 2, "two are fused")
        os.kill(pid, signal.SIGKILL)
        until(lambda: node.status()["sources"][1]["pid"] not in (None, pid), "it is started again")
        until(lambda: node.chart()["arrays"].min() == 3, "all three are fused again")
        until(lambda: node.status()["state"] == "running", "nothing is wrong any more")
    node.stop()
    assert node.wait(DEADLINE_S)
    summary = node.close()
    assert node.failure is None
    assert summary["frames_in"] == summary["frames_estimated"] + sum(summary["dropped"].values())
    assert summary["feeder_restarts"] == 0


def test_a_killed_feeder_process_takes_the_sources_up_again(
    make_node: MakeNode, recordings: list[Path], tmp_path: Path
) -> None:
    node = make_node(_live(recordings, tmp_path), "tracking.motion=off")
    node.start()
    until(lambda: all(s["details"] for s in node.status()["sources"]), "the sources tell where they listen")
    pids = [source["pid"] for source in node.status()["sources"]]
    with Producers(node, recordings):
        until(lambda: node.status()["frames_estimated"] > 50, "frames are estimated")
        feeder = node.feeder_pid
        assert feeder is not None
        os.kill(feeder, signal.SIGKILL)
        until(lambda: node.feeder_pid not in (None, feeder), "it is started again")
        before = node.status()["frames_estimated"]
        until(lambda: node.status()["frames_estimated"] > before + 50, "frames are estimated again")
        assert [source["pid"] for source in node.status()["sources"]] == pids
    node.stop()
    assert node.wait(DEADLINE_S)
    summary = node.close()
    assert summary["frames_in"] == summary["frames_estimated"] + sum(summary["dropped"].values())


def test_a_source_that_cannot_be_opened_at_the_start_is_told(
    make_node: MakeNode, recordings: list[Path], tmp_path: Path
) -> None:
    document = _live(recordings, tmp_path)
    document["source"][1]["endpoint"] = "ipc:///nowhere/at/all"
    node = make_node(document)
    with pytest.raises(SetupError, match=r"source of .*nowhere"):
        node.start()
