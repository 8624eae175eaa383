from __future__ import annotations

from pathlib import Path

import pytest

from chachart import sources
from chachart.node.commands.main import main

WORDS = (
    "--csi csi --ue ue --time time_ns --position position --axes frame,antenna,subcarrier --carrier-hz 2e9 "
    "--subcarrier-spacing-hz 312500 --array-position 0,0,10 --array-axis y"
)


def test_the_capture_that_comes_with_chachart_is_small_and_can_be_charted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    packaged = Path(next(iter(sources.__path__))) / "formats" / "sample.npz"
    assert packaged.stat().st_size < 300_000
    monkeypatch.chdir(tmp_path)
    assert main(["import", "sample.npz", "walk.mcap", *WORDS.split()]) == 0
    assert "240 frames of 16 UEs, 8 antennas x 16 subcarriers" in capsys.readouterr().out
    assert main(["evaluate", "walk.mcap", "--theta", "joint", "--rho", "joint"]) == 0
    assert "240 frames of 16 UEs" in capsys.readouterr().out
