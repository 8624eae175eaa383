"""Real nodes: a recording to feed them, and the command as somebody would run it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from node_runs import ARRAY, Running, capture_blocks

from chachart.node.files.recording import RecordingWriter


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 1000 frames of 40 UEs."""
    path = tmp_path_factory.mktemp("capture") / "capture.mcap"
    with RecordingWriter(path, ARRAY) as writer:
        for block in capture_blocks():
            writer.write(block)
    return path


@pytest.fixture
def run_node(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    """Starts `chachart-node` on a configuration text; whatever still runs at the end is killed."""
    started: list[Running] = []

    def run(config: str, *arguments: str) -> Running:
        number = len(started)
        files = [tmp_path / f"{number}.{suffix}" for suffix in ("toml", "log", "json")]
        files[0].write_text(config)
        command = [sys.executable, "-m", "chachart.node.commands.node", "--config", str(files[0])]
        with files[1].open("w") as log:
            process = subprocess.Popen(
                [*command, "--summary", str(files[2]), *arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                text=True,
                env={**os.environ, "TMPDIR": str(tmp_path), "PYTHONWARNINGS": "error"},
            )
        started.append(Running(process, files[1], files[2]))
        return started[-1]

    yield run
    for node in started:
        if node.process.poll() is None:
            node.signal(signal.SIGKILL)
        node.finish()
