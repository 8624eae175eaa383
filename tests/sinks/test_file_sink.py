"""What a full, vanished or read-only disk costs: what the files hold afterwards, and what is counted."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chart_samples import QUALITY, some_chart
from csi_samples import assert_same_frames, small_array, some_block

from chachart.node.data.csi import CsiBlock
from chachart.node.files.chart_log import ChartLogReader
from chachart.node.files.recording import RecordingReader
from chachart.sinks.chart_log import ChartLog, ChartLogSettings
from chachart.sinks.quality_log import QualityLog, QualityLogSettings
from chachart.sinks.recorder import Recorder, RecorderSettings

WIDE = {"antennas": 64, "subcarriers": 32}
BLOCK_BYTES = 16 * 64 * 32 * 8


def blocks(n: int) -> list[CsiBlock]:
    """Blocks of 256 KiB, a chunk each, that follow each other."""
    return [some_block(16, seq=16 * i, **WIDE) for i in range(n)]


def recorder(path: Path, **settings: Any) -> Recorder:
    sink = Recorder(RecorderSettings(path=path, **settings), small_array(**WIDE))
    sink.open(None)
    return sink


@pytest.fixture
def small_disk() -> Iterator[int]:
    """Files of this process cannot grow beyond so many bytes, as on a full disk."""
    limit = 2 * BLOCK_BYTES + 100_000
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    yield limit
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_recording_ends_at_its_last_whole_chunk_and_the_next_one_begins(
    tmp_path: Path, small_disk: int, caplog: pytest.LogCaptureFixture
) -> None:
    sink = recorder(tmp_path / "csi.mcap")
    given = blocks(6)
    for block in given[:3]:
        sink.on_csi(block)
    assert sink.lost.as_dict() == {"disk_full": 16}
    assert sink.trouble == f"{tmp_path / 'csi.mcap'} has ended: File too large"
    sink.on_csi(given[3])  # it is not time to try again
    assert sink.lost.as_dict() == {"disk_full": 32}
    sink.retry_s = sink._retry_at = 0
    for block in given[4:]:
        sink.on_csi(block)
    sink.close()
    assert sink.trouble is None
    first, second = RecordingReader(tmp_path / "csi.mcap"), RecordingReader(tmp_path / "csi-2.mcap")
    assert first.closed_properly
    assert second.closed_properly
    assert_same_frames(list(first.blocks()), given[:2])
    assert_same_frames(list(second.blocks()), given[4:])
    assert [r.levelname for r in caplog.records if "csi.mcap has ended" in r.message] == ["ERROR"]
    assert "32 disk_full lost until now" in caplog.text


def test_what_closing_cannot_write_is_counted(tmp_path: Path, small_disk: int) -> None:
    sink = recorder(tmp_path / "csi.mcap")
    for block in blocks(2):
        sink.on_csi(block)
    sink.on_csi(some_block(15, seq=32, **WIDE))  # not yet a chunk
    sink.close()
    assert sink.lost.as_dict() == {"disk_full": 15}
    assert RecordingReader(tmp_path / "csi.mcap").summary().frames == 32


def test_a_folder_that_is_gone_and_comes_back(tmp_path: Path) -> None:
    folder = tmp_path / "stick"
    folder.mkdir()
    sink = recorder(folder / "csi.mcap")
    sink.retry_s = 0
    given = blocks(4)
    sink.on_csi(given[0])
    shutil.rmtree(folder)
    for block in given[1:3]:
        sink.on_csi(block)
    assert sink.lost.as_dict() == {"folder_gone": 32}
    assert "No such file" in (sink.trouble or "") or "removed" in (sink.trouble or "")
    folder.mkdir()
    sink.on_csi(given[3])
    sink.close()
    assert_same_frames(list(RecordingReader(folder / "csi.mcap").blocks()), given[3:])


def test_a_chart_log_keeps_whole_chunks_and_goes_on(tmp_path: Path, small_disk: int) -> None:
    settings = ChartLogSettings(path=tmp_path / "a.mcap", every_s=0)
    sink = ChartLog(settings, small_array())
    sink.open(None)
    sink.retry_s = 0
    given = 0
    while not sink.lost.total():
        sink.on_chart(some_chart(256, first_ue=given, seed=given))
        given += 256
    sink.on_chart(some_chart(256, first_ue=given, seed=given))
    sink.close()
    assert len(list(tmp_path.iterdir())) == 2
    logs = [ChartLogReader(tmp_path / name) for name in ("a.mcap", "a-2.mcap")]
    kept = sum(len(chart) for log in logs for chart in log.charts())
    assert [log.damaged.as_dict() for log in logs] == [{"cut_off": 1}, {}]
    assert kept + sink.lost.total() == given + 256
    assert kept >= 512


def test_a_quality_log_has_whole_lines_only(tmp_path: Path, small_disk: int) -> None:
    path = tmp_path / "quality.jsonl"
    path.write_bytes(b" " * (small_disk - 300) + b"\n")
    sink = QualityLog(QualityLogSettings(path=path), small_array())
    sink.open(None)
    for _ in range(20):
        sink.on_quality(QUALITY)
    sink.close()
    lines = path.read_text().splitlines()[1:]
    assert [json.loads(line)["array"] for line in lines] == ["lab"] * len(lines)
    assert 0 < len(lines) < 20
    assert sink.lost.as_dict() == {"disk_full": 20 - len(lines)}


SCRIPT = """
import sys
from pathlib import Path
from csi_samples import small_array, some_block
from chachart.sinks.recorder import Recorder, RecorderSettings
wide, folder = {"antennas": 64, "subcarriers": 32}, Path(sys.argv[1])
ballast = folder / "ballast"
ballast.write_bytes(bytes(2 * 1024 * 1024))
sink = Recorder(RecorderSettings(path=folder / "csi.mcap"), small_array(**wide))
sink.retry_s = 0
sink.open(None)
for i in range(40):
    if i == 30:
        ballast.unlink()
    sink.on_csi(some_block(16, seq=16 * i, **wide))
sink.close()
from chachart.node.files.recording import RecordingReader
files = sorted(folder.glob("csi*.mcap"))
kept = [RecordingReader(path).summary().frames for path in files]
print(len(files), sum(kept), sink.lost.total(), min(kept))
"""


def test_a_small_disk_that_fills_up_and_gets_room_again(tmp_path: Path) -> None:
    """A real file system of 4 MiB, half of it taken until the 30th block of 256 KiB."""
    mount = f'mount -t tmpfs -o size=4m tmpfs {tmp_path} && exec {sys.executable} -c "$0" {tmp_path}'
    private = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    if subprocess.run([*private, f"mount -t tmpfs tmpfs {tmp_path}"], capture_output=True).returncode:
        pytest.skip("this machine does not let users mount a file system of their own")
    helpers = str(Path(__file__).parents[1] / "helpers")
    done = subprocess.run(
        [*private, mount, SCRIPT],
        env={**os.environ, "PYTHONPATH": helpers},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    files, kept, lost, fewest = map(int, done.stdout.split())
    assert kept + lost == 40 * 16
    assert files >= 2
    assert fewest > 0
    assert kept >= 12 * 16
