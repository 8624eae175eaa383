"""`chachart-node RECORDING`: it just plays, whatever the capture allows."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from csi_samples import small_array, some_block

from chachart.node.commands.node import main
from chachart.node.data.facts import CaptureFacts
from chachart.node.files.recording import RecordingWriter

RELATIVE = {"phase": "random", "delay": "relative"}


def recorded(path: Path, facts: CaptureFacts, antennas: int = 4) -> Path:
    with RecordingWriter(path, small_array(antennas), facts=facts) as writer:
        writer.write(some_block(antennas=antennas, frames=20))
    return path


@pytest.mark.parametrize(
    ("facts", "antennas", "methods"),
    [
        (CaptureFacts(**RELATIVE, power="rssi"), 4, ("bartlett", "isq")),
        (CaptureFacts(**RELATIVE, power="rssi"), 1, ("none", "isq")),
    ],
)
def test_methods_are_those_that_the_capture_allows(
    facts: CaptureFacts, antennas: int, methods: tuple[str, str], tmp_path: Path
) -> None:
    recording, summary = recorded(tmp_path / "a.mcap", facts, antennas), tmp_path / "s.json"
    play = [recording, "--set", "source.speed=0", "source.at_end=end", "--summary", summary]
    subprocess.run([sys.executable, "-m", "chachart.node.commands.node", *play], check=True)
    told = json.loads(summary.read_text())
    assert (told["method"]["theta"], told["method"]["rho"]) == methods
    assert told["frames_in"] == told["frames_estimated"] == 20


def test_a_capture_that_says_nothing_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = recorded(tmp_path / "a.mcap", CaptureFacts(**RELATIVE), antennas=1)
    assert main([str(recording)]) == 78
    assert "nothing can be charted: one antenna sees no direction" in capsys.readouterr().err
