from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zmq
from chart_samples import STATUS

from chachart.node.data.chart import ChartUpdate
from chachart.node.net.wire import chart_topic, encode_chart, encode_report

CHACHART = [sys.executable, "-m", "chachart.node.commands.main"]


@pytest.fixture
def endpoint(tmp_path: Path, make_update: Callable[..., ChartUpdate]) -> Iterator[str]:
    """A node's publisher: says the same chart again and again, leaving out every other message."""
    endpoint = f"ipc://{tmp_path}/charts"
    update = make_update(list(range(500)))
    over = threading.Event()

    def publish() -> None:
        with zmq.Context() as context, context.socket(zmq.PUB) as socket:
            socket.linger = 0
            socket.bind(endpoint)
            seq = 0
            while not over.wait(0.02):
                report = encode_report("quality", "lab", seq, 1, {"tw": 0.98765, "ct": 0.5})
                socket.send_multipart([b"quality.lab", report])
                socket.send_multipart([b"status.lab", encode_report("status", "lab", seq, 1, STATUS)])
                socket.send_multipart([chart_topic("lab"), encode_chart(update, seq)])
                seq += 2

    thread = threading.Thread(target=publish)
    thread.start()
    yield endpoint
    over.set()
    thread.join()


def test_lines_where_the_output_is_piped(endpoint: str) -> None:
    done = subprocess.run(
        [*CHACHART, "watch", endpoint, "--duration", "1.2", "--ue", "250"],
        capture_output=True,
        text=True,
        check=True,
    )
    line = done.stdout.splitlines()[-1]
    for word in ("lab: 500 UEs", "estimates/s", "bartlett/music", "TW 0.9877", "messages lost"):
        assert word in line
    assert "UE 250: θ 14.32 °, ρ 250.00 m, ± θ - °, ± ρ - m, x 250.00 m, y -250.00 m, SNR 25.00 dB" in line


def test_json(endpoint: str) -> None:
    command = [*CHACHART, "watch", endpoint, "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        messages = [json.loads(process.stdout.readline()) for _ in range(2)]
        process.send_signal(2)
        said = process.stderr.read()
        assert process.wait(20) == 130
    assert said == ""
    assert messages[0]["ue"] == list(range(500))
    assert messages[0]["theta_std"] == [None] * 500
    assert [m["gap"] for m in messages] == [0, 1]


def test_a_picture_in_a_terminal(endpoint: str) -> None:
    near, far = pty.openpty()
    command = [*CHACHART, "watch", endpoint, "--ue", "3", "--duration", "1.5"]
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "160", "LINES": "24"}
    with subprocess.Popen(command, stdout=far, stderr=far, env=environment) as process:
        os.close(far)
        seen = b""
        while True:
            try:
                seen += os.read(near, 65536)
            except OSError:
                break
        assert process.wait(20) == 0
    os.close(near)
    text = seen.decode(errors="replace")
    assert "lab: 500 UEs" in text
    assert any(0x2800 < ord(c) < 0x2900 for c in text), "braille dots"
    assert "array at x = y = 0" in text
    assert "busiest: " in text
    assert "node running, 0 frames/s in, backlog 0, 0 of 0 workers, dropped: 3 queue_full" in text
    assert "worst: 0 (0.0 dB), 1 (0.1 dB)" in text


def test_q_ends_it(endpoint: str) -> None:
    near, far = pty.openpty()
    command = [*CHACHART, "watch", endpoint]
    environment = {**os.environ, "TERM": "xterm-256color"}
    with subprocess.Popen(command, stdin=far, stdout=far, stderr=far, env=environment) as process:
        os.close(far)
        seen = b""
        while b"lab: 500 UEs" not in seen:
            seen += os.read(near, 65536)
        os.write(near, b"q")
        reader = threading.Thread(target=drain, args=(near,))
        reader.start()
        assert process.wait(20) == 0
    reader.join()
    os.close(near)


def drain(terminal: int) -> None:
    """Read until nobody writes any more."""
    try:
        while os.read(terminal, 65536):
            pass
    except OSError:
        return


def test_nobody_publishes(tmp_path: Path) -> None:
    command = [*CHACHART, "watch", f"ipc://{tmp_path}/nobody", "--duration", "0.1"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "waiting for a chart from ipc://" in done.stdout


def test_no_endpoint() -> None:
    done = subprocess.run([*CHACHART, "watch", "nowhere"], capture_output=True, text=True, check=False)
    assert done.returncode == 78
    assert done.stderr.startswith("chachart watch: nowhere is no endpoint")
    assert len(done.stderr.splitlines()) == 1
