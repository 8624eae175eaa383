from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csi_samples import START_NS, assert_same_frames, small_array, some_block
from pydantic import ValidationError
from source_contract import SourceCase, SourceContract, receive

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import RequestError, SetupError
from chachart.node.files.recording import RecordingWriter
from chachart.sources.base import EndOfSource
from chachart.sources.recording import Recording, RecordingSettings
from chachart.sources.simulator import Simulator, SimulatorSettings

MS = 1_000_000


@pytest.fixture
def blocks() -> list[CsiBlock]:
    """200 frames, one a millisecond, numbered from 1000."""
    return [some_block(10, seq=1000 + 10 * i, start_ns=START_NS + 10 * i * MS, step_ns=MS) for i in range(20)]


@pytest.fixture
def path(tmp_path: Path, blocks: list[CsiBlock]) -> Path:
    with RecordingWriter(tmp_path / "a.mcap", small_array(), chunk_bytes=1024) as writer:
        for block in blocks:
            writer.write(block)
    return tmp_path / "a.mcap"


def play(path: Path, **settings: Any) -> list[CsiBlock]:
    with Recording(RecordingSettings(path=path, **{"speed": 0, **settings}), small_array()) as source:
        return receive(source, 10**9)


class TestContract(SourceContract):
    @pytest.fixture
    def case(self, path: Path) -> SourceCase:
        return SourceCase("recording", {"path": path, "speed": 50.0}, small_array())


def test_it_plays_everything_and_ends(path: Path, blocks: list[CsiBlock]) -> None:
    assert_same_frames(play(path), blocks)


def test_the_end_stays_the_end(path: Path) -> None:
    with Recording(RecordingSettings(path=path, speed=0), small_array()) as source:
        receive(source, 10**9)
        with pytest.raises(EndOfSource):
            source.recv(0.0)


@pytest.mark.parametrize(
    ("from_s", "to_s", "rows"), [(0.0, 0.05, (0, 50)), (0.033, None, (33, 200)), (0.1, 0.15, (100, 150))]
)
def test_from_and_to(
    path: Path, blocks: list[CsiBlock], from_s: float, to_s: float | None, rows: tuple[int, int]
) -> None:
    expected = CsiBlock.concatenate(blocks).take(np.arange(*rows))
    assert_same_frames(play(path, from_s=from_s, to_s=to_s), expected)


def test_rounds_go_on_in_time(path: Path, blocks: list[CsiBlock]) -> None:
    played = CsiBlock.concatenate(play(path, loops=3))
    assert len(played) == 600
    np.testing.assert_array_equal(np.diff(played.time_ns) > 0, True)
    np.testing.assert_array_equal(played.ue[200:400], played.ue[:200])
    np.testing.assert_array_equal(np.diff(played.time_ns[::200]), np.diff(played.time_ns[::200])[0])


def test_the_recorded_pace_is_kept(path: Path, blocks: list[CsiBlock]) -> None:
    """At no moment are frames given out that are not due yet; asked at once, hardly any is."""
    with Recording(RecordingSettings(path=path, speed=0.001), small_array()) as source:
        first = source.recv(0.0)
        assert first is not None
        assert len(first) == 1
        assert source.recv(0.01) is None
    assert_same_frames(play(path, speed=20.0), blocks)


def test_a_recording_of_a_killed_writer_plays(path: Path, blocks: list[CsiBlock]) -> None:
    path.write_bytes(path.read_bytes()[:9000])
    played = CsiBlock.concatenate(play(path))
    assert_same_frames(played, CsiBlock.concatenate(blocks).take(np.arange(len(played))))


def test_unusable_frames_and_damaged_chunks_are_counted(tmp_path: Path) -> None:
    block = some_block(6)
    block.csi[1, 0, 0] = np.nan
    block.csi[2] = 0
    with RecordingWriter(tmp_path / "a.mcap", small_array(), chunk_bytes=16) as writer:
        writer.write(block)
        writer.write(some_block(6, seq=6))
    content = bytearray((tmp_path / "a.mcap").read_bytes())
    content[content.index(some_block(6, seq=6).csi.tobytes())] ^= 1
    (tmp_path / "a.mcap").write_bytes(content)
    with Recording(RecordingSettings(path=tmp_path / "a.mcap", speed=0), small_array()) as source:
        played = receive(source, 10**9)
        assert source.rejected.as_dict() == {"non_finite": 1, "all_zero": 1, "chunk_crc": 1}
    assert_same_frames(played, block.take(np.array([0, 3, 4, 5])))


def test_another_array_is_refused(path: Path) -> None:
    source = Recording(RecordingSettings(path=path), small_array(carrier_hz=3e9))
    with pytest.raises(SetupError, match="another array: carrier_hz"):
        source.open()


def test_the_name_of_the_array_is_the_nodes(path: Path) -> None:
    with Recording(RecordingSettings(path=path), small_array(name="roof")) as source:
        assert receive(source, 1)[0].array == "roof"


@pytest.mark.parametrize(
    ("settings", "says"),
    [({"path": "nowhere.mcap"}, "nowhere.mcap"), ({"from_s": 5.0}, "holds no frames from 5 s to its end")],
)
def test_what_cannot_be_played_is_told(path: Path, settings: dict[str, Any], says: str) -> None:
    source = Recording(RecordingSettings(**{"path": path, **settings}), small_array())
    assert says in Recording.problems(source.settings)[0]
    with pytest.raises(SetupError, match=says):
        source.open()


def test_an_empty_recording_is_told(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "a.mcap", small_array()).close()
    settings = RecordingSettings(path=tmp_path / "a.mcap")
    assert "holds no frames" in Recording.problems(settings)[0]


def test_to_before_from_is_refused() -> None:
    with pytest.raises(ValidationError, match="to_s = 1 must be after from_s = 2"):
        RecordingSettings(from_s=2, to_s=1)


def test_it_jumps_pauses_and_goes_back_from_the_end(path: Path, blocks: list[CsiBlock]) -> None:
    settings = RecordingSettings(path=path, speed=0, at_end="stay")
    with Recording(settings, small_array()) as source:
        assert receive(source, 200)
        assert source.recv(0.0) is None, "the end is not the end of the source"
        played = source.details()["replay"]
        assert played["ended"]
        assert played["at_s"] == played["length_s"] == pytest.approx(0.199)
        plays = source.replay(at_s=0.15)
        assert (plays["ended"], plays["at_s"], plays["paused"]) == (False, 0.15, False)
        again = receive(source, 50)
        np.testing.assert_array_equal(
            np.concatenate([b.time_ns for b in again]), START_NS + np.arange(150, 200) * MS
        )
        assert again[0].seq == 200, "frames are numbered as they are played"
        source.replay(paused=True, at_s=0.0)
        assert source.recv(0.0) is None
        assert source.details()["replay"]["paused"]
        source.replay(paused=False)
        assert int(receive(source, 200)[0].time_ns[0]) == START_NS
        source.replay(paused=False)
        assert int(receive(source, 200)[0].time_ns[0]) == START_NS, "playing on at the end begins anew"
        with pytest.raises(RequestError, match="at_s must be from 0 to"):
            source.replay(at_s=1e6)


def test_a_pause_waits_until_all_ues_are_at_the_same_frame(path: Path, blocks: list[CsiBlock]) -> None:
    with Recording(RecordingSettings(path=path, speed=1e-6), small_array()) as source:
        source.replay(paused=True)
        assert source.recv(0.0) is None
        source.catching_up = True
        block = source.recv(0.0)
        assert block is not None
        np.testing.assert_array_equal(block.csi[: len(blocks[0])], blocks[0].csi)
        source.catching_up = False
        assert source.recv(0.0) is None


def test_density_says_where_the_frames_are(path: Path) -> None:
    with Recording(RecordingSettings(path=path), small_array()) as source:
        density = source.replay()["density"]
    assert len(density) == 200
    assert sum(density) == pytest.approx(1, abs=1e-3)
    np.testing.assert_allclose(np.add.reduceat(density, [0, 50, 100, 150]), 0.25, atol=0.05)


def test_only_a_recording_can_be_wound() -> None:
    with pytest.raises(RequestError, match="the source is simulator"):
        Simulator(SimulatorSettings(), small_array()).replay(paused=True)
