"""CSI from somebody else's program to somebody else's program, and recorded on the way."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq
from csi_samples import assert_same_frames
from mcap.reader import make_reader
from node_runs import ARRAY, Running, capture_blocks, until

from chachart.node.data.csi import CsiBlock
from chachart.node.files.recording import RecordingReader

RunNode = Callable[..., Running]


@pytest.fixture
def producer(tmp_path: Path) -> Iterator[zmq.Socket[bytes]]:
    with zmq.Context() as context, context.socket(zmq.PUSH) as socket:
        socket.sndhwm = 16
        socket.connect(f"ipc://{tmp_path}/csi")
        yield socket
        socket.linger = 0


@pytest.fixture
def subscriber(tmp_path: Path) -> Iterator[zmq.Socket[bytes]]:
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.connect(f"ipc://{tmp_path}/chart")
        socket.subscribe(b"")
        yield socket


def configuration(folder: Path) -> str:
    return f"""
[array]
antennas = {ARRAY.antennas}
subcarriers = {ARRAY.subcarriers}
carrier_hz = {ARRAY.carrier_hz}
element_spacing_m = {ARRAY.element_spacing_m}
subcarrier_spacing_hz = {ARRAY.subcarrier_spacing_hz}
position_m = [0.0, 0.0, 0.0]
[source]
type = "zmq"
endpoint = "ipc://{folder}/csi"
lossless = true
[quality]
every_s = 0.2
k = 5
[[sinks]]
type = "publisher"
endpoint = "ipc://{folder}/chart"
[[sinks]]
type = "recorder"
path = "{folder}/csi.mcap"
flush_s = 0.1
[[sinks]]
type = "chart_log"
path = "{folder}/chart.mcap"
[[sinks]]
type = "quality_log"
path = "{folder}/quality.jsonl"
"""


def send(socket: zmq.Socket[bytes], block: CsiBlock) -> None:
    """As the README tells a producer to, without chachart."""
    header = {
        "v": 1,
        "type": "csi",
        "array": "lab",
        "seq": block.seq,
        "shape": list(block.csi.shape),
        "dtype": "<c8",
        "ue": block.ue.tobytes(),
        "time_ns": block.time_ns.tobytes(),
    }
    if block.position is not None:
        header["position"] = block.position.tobytes()
    socket.send_multipart([msgpack.packb(header), block.csi.tobytes()])


def test_from_a_producer_to_a_subscriber_and_into_files(
    run_node: RunNode, producer: zmq.Socket[bytes], subscriber: zmq.Socket[bytes], tmp_path: Path
) -> None:
    node = run_node(configuration(tmp_path))
    blocks = capture_blocks()
    for block in [*blocks[:4], *blocks[5:], blocks[4]]:  # one comes late
        send(producer, block)
    producer.send_multipart([b"not msgpack", b""])
    seen: set[int] = set()
    estimated: list[int] = []

    def all_there() -> bool:
        while subscriber.poll(0):
            topic, body = subscriber.recv_multipart()
            message = msgpack.unpackb(body)
            if topic == b"chart.lab":
                seen.update(message["ue"])
            elif topic == b"status.lab":
                estimated.append(message["frames_estimated"])
        return len(seen) == 40 and estimated[-1:] == [1000]

    until(all_there, "a subscriber sees every UE, and all frames estimated")
    until(lambda: (tmp_path / "quality.jsonl").read_text().count("\n") > 1, "quality is logged")
    node.signal(signal.SIGINT)
    assert node.finish() == 0
    summary = node.summary()
    assert summary["frames_in"] == summary["frames_estimated"] == 1000
    assert summary["out_of_order"] == summary["gaps"] == 100
    assert summary["rejected"] == {"header": 1}

    recording = RecordingReader(tmp_path / "csi.mcap")
    assert recording.closed_properly
    assert recording.array.mismatches(ARRAY) == []
    assert_same_frames(list(recording.blocks()), [*blocks[:4], *blocks[5:], blocks[4]])
    with (tmp_path / "chart.mcap").open("rb") as file:
        logged = [json.loads(m.data) for _, c, m in make_reader(file).iter_messages("chart.lab")]
    assert {ue for chart in logged for ue in chart["ue"]} == set(range(40))
    assert json.loads((tmp_path / "quality.jsonl").read_text().splitlines()[-1])["tw"] > 0.9


def test_a_recording_outlives_a_killed_node_and_replays(
    run_node: RunNode, producer: zmq.Socket[bytes], tmp_path: Path
) -> None:
    node = run_node(configuration(tmp_path))
    blocks = capture_blocks()
    for block in blocks:
        send(producer, block)
    path = tmp_path / "csi.mcap"
    until(lambda: path.exists() and path.stat().st_size > 500_000, "half of it is recorded")
    node.signal(signal.SIGKILL)
    node.finish()
    reader = RecordingReader(path)
    kept = CsiBlock.concatenate(list(reader.blocks()))
    assert not reader.closed_properly
    assert_same_frames(kept, CsiBlock.concatenate(blocks).take(np.arange(len(kept))))

    replay = run_node(f'[source]\ntype = "recording"\npath = "{path}"\nspeed = 0\n')
    assert replay.finish() == 0
    assert replay.summary()["frames_in"] == replay.summary()["frames_estimated"] == len(kept)
    assert re.search(rf"frames in {len(kept)}\b", replay.said())
