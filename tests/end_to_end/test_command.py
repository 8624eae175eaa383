"""`chachart-node` as somebody would run it."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgpack
import pytest
import zmq
from node_runs import Running, adds_up, until

from chachart.node.commands.node import main

RunNode = Callable[..., Running]

LIVE = """
[array]
antennas = 8
subcarriers = 4
[source]
type = "simulator"
ues = 50
frame_rate_hz = 2000
[workers]
count = 2
[quality]
every_s = 0.5
"""


def replay(capture: Path, more: str = "") -> str:
    return f'[source]\ntype = "recording"\npath = "{capture}"\nspeed = 0\n{more}'


def busy(node: Running) -> None:
    """Wait until it estimates."""
    until(lambda: len(node.children("worker")) > 0 or node.process.poll() is not None, "workers start")
    until(lambda: "frames are read" in node.said() or node.process.poll() is not None, "it reads")


def gone(pids: list[int]) -> bool:
    return not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_a_recording_that_ends_ends_the_node(run_node: RunNode, capture: Path) -> None:
    node = run_node(replay(capture))
    assert node.finish() == 0
    summary = node.summary()
    assert summary["frames_in"] == summary["frames_estimated"] == 1000
    assert set(summary) >= {"dropped", "rejected", "seconds", "quality", "latency_ms", "worker_restarts"}
    assert set(summary["quality"]) >= {"tw", "ct", "k"}
    assert "frames in 1000, estimated 1000, dropped 0" in node.said()


def test_the_first_signal_drains(run_node: RunNode, tmp_path: Path) -> None:
    node = run_node(LIVE)
    busy(node)
    children = node.children("")
    for (
        pid
    ) in children:  # a terminal's or systemd's signals may reach them too: they wait for the main process
        os.kill(pid, signal.SIGINT)
        os.kill(pid, signal.SIGTERM)
    node.signal(signal.SIGTERM)
    assert node.finish() == 0
    summary = node.summary()
    assert adds_up(summary)
    assert summary["worker_restarts"] == 0
    assert "drain_deadline" not in summary["dropped"]
    assert gone(children)
    assert list(tmp_path.glob("chachart-*")) == []


def test_the_second_signal_ends_it_at_once(run_node: RunNode, capture: Path, tmp_path: Path) -> None:
    node = run_node(replay(capture, "loops = 0"))
    busy(node)
    children = node.children("")
    for pid in node.children("worker"):
        os.kill(pid, signal.SIGSTOP)
    node.signal(signal.SIGINT)
    until(lambda: "draining" in node.said(), "the drain begins")
    node.signal(signal.SIGINT)
    assert node.finish() == 128 + signal.SIGINT
    until(lambda: gone(children), "the children are gone")
    assert list(tmp_path.glob("chachart-*")) == []


def test_children_follow_the_main_process_in_death(run_node: RunNode, tmp_path: Path) -> None:
    node = run_node(LIVE)
    busy(node)
    children = node.children("")
    assert len(children) >= 3
    node.signal(signal.SIGKILL)
    node.finish()
    until(lambda: gone(children), "the children are gone")
    assert list(tmp_path.glob("chachart-*")) == []


def test_anybody_can_subscribe_even_while_a_worker_is_killed(run_node: RunNode, tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path / 'charts'}"
    node = run_node(LIVE + f'[[sinks]]\ntype = "publisher"\nendpoint = "{endpoint}"\n')
    with zmq.Context() as context, context.socket(zmq.SUB) as subscriber:
        subscriber.connect(endpoint)
        for kind in ("chart", "status", "quality"):
            subscriber.subscribe(f"{kind}.lab".encode())
        seen: set[int] = set()
        kinds: set[str] = set()
        killed = None

        def enough() -> bool:
            nonlocal killed
            while subscriber.poll(0):
                topic, body = subscriber.recv_multipart()
                message = msgpack.unpackb(body)
                assert topic == f"{message['type']}.lab".encode()
                kinds.add(message["type"])
                if message["type"] == "chart":
                    seen.update(message["ue"])
                    assert len(message["ue"]) == len(message["x"]) == len(message["theta"])
                if message["type"] == "status" and len(seen) == 50 and killed is None:
                    killed = message["workers"][0]["pid"]  # None until the first report that knows it
                    if killed is not None:
                        os.kill(killed, signal.SIGKILL)
                        seen.clear()
            return killed is not None and len(seen) == 50 and kinds == {"chart", "status", "quality"}

        until(enough, "all UEs are published, again after a kill")
    assert f"(process {killed}) died: killed by SIGKILL; restarting" in node.said()
    node.signal(signal.SIGINT)
    assert node.finish() == 0
    summary = node.summary()
    assert summary["worker_restarts"] == 1
    assert adds_up(summary)
    assert set(summary["dropped"]) <= {"worker_lost", "queue_full"}


def test_ctrl_c_in_a_terminal(run_node: RunNode, tmp_path: Path) -> None:
    """A live panel while it runs, one Ctrl-C for the whole foreground group, a drain, the summary."""
    terminal, tty = pty.openpty()
    config, shown = tmp_path / "live.toml", bytearray()
    config.write_text(LIVE)
    script = f'exec "$0" -m chachart.node.commands.node --config "$1" 0<>"{os.ttyname(tty)}" >&0 2>&0'
    process = subprocess.Popen(
        ["sh", "-c", script, sys.executable, str(config)],
        start_new_session=True,  # so that the terminal becomes its own, and Ctrl-C its signal
        env={**os.environ, "TERM": "xterm", "COLUMNS": "120", "TMPDIR": str(tmp_path)},
    )

    def appears(text: bytes) -> bool:
        while select.select([terminal], [], [], 0)[0]:
            try:
                shown.extend(os.read(terminal, 65536))
            except OSError:  # the last one to have it open is gone
                break
        return text in shown

    try:
        until(lambda: appears(b"running"), "the panel shows that it runs")
        os.write(terminal, b"\x03")
        until(lambda: appears(b"frames in ") and process.poll() is not None, "it drains and ends")
    finally:
        process.kill()
        process.wait()
        os.close(terminal)
        os.close(tty)
    assert process.returncode == 0
    assert b"Traceback" not in shown
    assert b"died" not in shown
    assert b"draining" in shown
    assert b"INFO:chachart" not in shown  # the level stands in a column of its own


def test_duration_ends_it(run_node: RunNode) -> None:
    node = run_node(LIVE, "--duration", "0.5", "--log-format", "json")
    assert node.finish() == 0
    assert node.summary()["seconds"] >= 0.5
    assert adds_up(node.summary())
    records = [json.loads(line) for line in node.said().splitlines() if line.startswith("{")]
    assert {"time", "level", "logger", "message"} <= set(records[0])


def test_a_summary_that_the_disk_refuses(run_node: RunNode) -> None:
    node = run_node(LIVE, "--duration", "0.2", "--summary", "/dev/full")
    assert node.finish() == 1
    assert "--summary /dev/full: cannot be written: No space left on device" in node.said()
    assert "Traceback" not in node.said()


@pytest.mark.parametrize("arguments", [("--check",), ()])
def test_mistakes_are_told_at_once_and_without_traceback(
    run_node: RunNode, capture: Path, arguments: tuple[str, ...]
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        text = f"""
[source]
type = "recording"
path = "nowhere.mcap"
[[sinks]]
type = "publisher"
endpoint = "{endpoint}"
"""
        node = run_node(text, *arguments)
        assert node.finish() == 78
    said = node.said()
    assert "nowhere.mcap" in said
    assert endpoint in said
    assert "Traceback" not in said


def test_an_array_that_differs_from_the_recordings(run_node: RunNode, capture: Path) -> None:
    node = run_node("[array]\nantennas = 32\nsubcarriers = 8\n" + replay(capture), "--check")
    assert node.finish() == 78
    assert "antennas: 32 against 16" in node.said()
    assert "Traceback" not in node.said()


def test_no_array_at_all(run_node: RunNode) -> None:
    node = run_node('[source]\ntype = "simulator"\n', "--check")
    assert node.finish() == 78
    assert "[array] is missing" in node.said()


def test_check_of_a_good_configuration(run_node: RunNode, capture: Path) -> None:
    node = run_node(replay(capture), "--check")
    assert node.finish() == 0
    assert "nothing wrong" in node.said()
    assert not node.summary_file.exists()


@pytest.mark.parametrize("arguments", [("--duration", "-1"), ("--duration", "soon"), ("--dance",)])
def test_wrong_arguments(arguments: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2


def test_a_summary_that_cannot_be_written(run_node: RunNode, tmp_path: Path) -> None:
    node = run_node(LIVE, "--check", "--summary", str(tmp_path / "no" / "such.json"))
    assert node.finish() == 78
    assert "such.json: cannot be written" in node.said()
