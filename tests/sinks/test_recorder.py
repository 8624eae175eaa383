from __future__ import annotations

from pathlib import Path

import pytest
from csi_samples import assert_same_frames, small_array, some_block
from sink_contract import SinkCase, SinkContract

from chachart.node.data.facts import CaptureFacts
from chachart.node.files.recording import RecordingReader
from chachart.sinks.recorder import Recorder, RecorderSettings

WIDE = {"antennas": 64, "subcarriers": 32}


class TestContract(SinkContract):
    @pytest.fixture
    def case(self, tmp_path: Path) -> SinkCase:
        settings = {"path": tmp_path / "csi-{time}.mcap"}
        return SinkCase("recorder", settings, small_array(), impossible={"path": tmp_path / "no" / "a.mcap"})


def recorder(path: Path, **settings: int) -> Recorder:
    recorder = Recorder(RecorderSettings(path=path, **settings), small_array(**WIDE))
    recorder.open(None)
    return recorder


def test_files_are_rotated_by_size_and_nothing_is_lost(tmp_path: Path) -> None:
    sink = recorder(tmp_path / "csi.mcap", max_bytes=1024**2)
    blocks = [some_block(16, seq=16 * i, **WIDE) for i in range(12)]  # 256 KiB each
    for block in blocks:
        sink.on_csi(block)
    sink.close()
    names = ["csi.mcap", "csi-2.mcap", "csi-3.mcap"]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    readers = [RecordingReader(tmp_path / name) for name in names]
    assert all(reader.closed_properly and reader.array == small_array(**WIDE) for reader in readers)
    assert_same_frames([block for reader in readers for block in reader.blocks()], blocks)


def test_what_phase_and_delay_mean_is_recorded(tmp_path: Path) -> None:
    sink = Recorder(RecorderSettings(path=tmp_path / "csi.mcap"), small_array(**WIDE))
    sink.facts = CaptureFacts("random", "relative", "rssi", {7: "02:00:00:00:00:07"})
    sink.open(None)
    sink.on_csi(some_block(1, **WIDE))
    sink.close()
    assert RecordingReader(tmp_path / "csi.mcap").facts == sink.facts


def test_a_slow_stream_is_flushed(tmp_path: Path) -> None:
    sink = recorder(tmp_path / "csi.mcap")
    sink.on_csi(some_block(1, **WIDE))
    sink.on_tick()
    assert RecordingReader(tmp_path / "csi.mcap").summary().frames == 1
    sink.close()
