from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from wifi_captures import integers, intel5300, nexmon

from chachart.node.commands.main import main
from chachart.node.data.csi import CsiBlock
from chachart.node.files.recording import RecordingReader


def read(tmp_path: Path) -> CsiBlock:
    return CsiBlock.concatenate(list(RecordingReader(tmp_path / "out.mcap").blocks()))


def test_a_wifi_capture_needs_no_options_but_what_it_cannot_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csi = integers(6, 30, 3, 2)
    (tmp_path / "in.dat").write_bytes(intel5300(csi, senders=[1, 2, 1, 1, 0, 1]) + intel5300(csi[:2, :, :2]))
    arguments = ["import", str(tmp_path / "in.dat"), str(tmp_path / "out.mcap")]
    assert main(arguments) == 78
    assert "--carrier-hz is needed" in capsys.readouterr().err
    assert main([*arguments, "--carrier-hz", "5.32e9"]) == 0
    told = capsys.readouterr().out
    for words in ("6 of 8 frames", "2 (other shape)", "A + B + C", "--kind 2 picks 2 frames of 2 antennas"):
        assert words in told
    reader = RecordingReader(tmp_path / "out.mcap")
    assert (reader.facts.phase, reader.facts.delay, reader.facts.power) == ("random", "relative", "rssi")
    assert reader.facts.senders[0x0200_0000_0001] == "02:00:00:00:00:01"
    assert main([*arguments, "--carrier-hz", "5.32e9", "--strict", "--force"]) == 78
    assert main([*arguments, "--carrier-hz", "5.32e9", "--kind", "2", "--power", "raw", "--force"]) == 0
    np.testing.assert_array_equal(read(tmp_path).csi, csi[:2, :, :2, 0].transpose(0, 2, 1))


def test_frames_of_one_sender(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in.dat").write_bytes(intel5300(integers(6, 30, 3, 1), senders=[1, 2, 1, 1, 2, 1]))
    arguments = ["import", str(tmp_path / "in.dat"), str(tmp_path / "out.mcap"), "--carrier-hz", "5.32e9"]
    assert main([*arguments, "--ue-mac", "02:00:00:00:00:02"]) == 0
    assert "4 (other sender)" in capsys.readouterr().out
    assert set(read(tmp_path).ue.tolist()) == {0x0200_0000_0002}
    assert main([*arguments, "--force", "--ue-mac", "02:00:00:00:00:03"]) == 78
    assert "02:00:00:00:00:01" in capsys.readouterr().err


def test_received_power_becomes_amplitude(tmp_path: Path) -> None:
    (tmp_path / "in.dat").write_bytes(intel5300(integers(6, 30, 3, 1)))
    arguments = ["import", str(tmp_path / "in.dat"), str(tmp_path / "out.mcap"), "--carrier-hz", "5.32e9"]
    assert main(arguments) == 0
    milliwatts = (10**4.0 + 10**4.1 + 10**4.2) * 10 ** (-(44 + 30) / 10)
    np.testing.assert_allclose(np.mean(np.abs(read(tmp_path).csi) ** 2, axis=(1, 2)), milliwatts, rtol=1e-5)


def test_a_dead_antenna_and_guards_do_not_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csi = integers(4, 3, 64, limit=2000)
    csi[:, 1] = 0
    (tmp_path / "in.pcap").write_bytes(nexmon(csi))
    arguments = ["import", str(tmp_path / "in.pcap"), str(tmp_path / "out.mcap")]
    assert main(arguments) == 0
    assert "antenna 1 measures nothing" in capsys.readouterr().out
    array = RecordingReader(tmp_path / "out.mcap").array
    assert (array.subcarriers, array.dead_antennas, array.dead_tones) == (56, (1,), (55,))
    assert main([*arguments, "--tones", "all", "--force"]) == 0
    assert RecordingReader(tmp_path / "out.mcap").array.tones == tuple(range(-32, 32))
