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
from chachart.node.files.recording import RecordingReader, RecordingWriter

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


def test_what_is_recorded_while_it_plays_says_the_same_of_phase_and_delay(tmp_path: Path) -> None:
    facts = CaptureFacts(**RELATIVE, power="rssi", senders={1: "02:00:00:00:00:01"})
    recording, config = recorded(tmp_path / "a.mcap", facts), tmp_path / "n.toml"
    config.write_text(
        f'[source]\ntype = "recording"\npath = "{recording}"\nspeed = 0\nat_end = "end"\n'
        f'[estimator]\nrho = "isq"\n[[sinks]]\ntype = "recorder"\npath = "{tmp_path}/b.mcap"\n'
    )
    subprocess.run([sys.executable, "-m", "chachart.node.commands.node", "--config", config], check=True)
    assert RecordingReader(tmp_path / "b.mcap").facts == facts


def test_a_capture_that_says_nothing_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = recorded(tmp_path / "a.mcap", CaptureFacts(**RELATIVE), antennas=1)
    assert main([str(recording)]) == 78
    assert "nothing can be charted: one antenna sees no direction" in capsys.readouterr().err
