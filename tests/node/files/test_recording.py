"""Recordings: what is written is read, whatever happened to the writer or to the file."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from csi_samples import START_NS, assert_same_frames, small_array, some_block
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import McapReader, NonSeekingReader, SeekingReader, make_reader
from mcap.records import ChunkIndex, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from chachart.node.data.calibration import Calibration
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.files.recording import RecordingReader, RecordingWriter
from chachart.node.net.wire import decode_csi_map

MS = 1_000_000
one_folder = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def record(path: Path, blocks: list[CsiBlock], chunk_bytes: int = 2048) -> Path:
    with RecordingWriter(path, small_array(), note={"who": "test"}, chunk_bytes=chunk_bytes) as writer:
        for block in blocks:
            writer.write(block)
    return path


def run_of_blocks(n: int, frames: int = 5) -> list[CsiBlock]:
    return [
        some_block(frames, seq=i * frames, start_ns=START_NS + i * frames * MS, step_ns=MS) for i in range(n)
    ]


@dataclass(frozen=True)
class Recorded:
    """A closed recording: its bytes and frames, where its head and each chunk end, and frames a chunk."""

    content: bytes
    frames: CsiBlock
    head_end: int
    chunk_ends: list[int]
    frames_per_chunk: int

    def complete_at(self, cut: int) -> int:
        """Frames in chunks that end before byte `cut`."""
        return sum(end <= cut for end in self.chunk_ends) * self.frames_per_chunk

    def first(self, n: int) -> CsiBlock:
        return self.frames.take(np.arange(n))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """200 frames, one a millisecond, in 8 chunks."""
    blocks = run_of_blocks(40)
    content = record(tmp_path_factory.mktemp("recorded") / "whole.mcap", blocks).read_bytes()
    chunks = [r for r in StreamReader(io.BytesIO(content)).records if isinstance(r, ChunkIndex)]
    assert len(chunks) == 8
    ends = [c.chunk_start_offset + c.chunk_length for c in chunks]
    return Recorded(content, CsiBlock.concatenate(blocks), chunks[0].chunk_start_offset, ends, 25)


def frames_in(blocks: list[CsiBlock]) -> int:
    return sum(len(block) for block in blocks)


@pytest.mark.parametrize("position", [True, False])
def test_what_is_written_is_read(tmp_path: Path, position: bool) -> None:
    blocks = [some_block(n, seq=n, seed=n, position=position) for n in (1, 64, 3)]
    reader = RecordingReader(record(tmp_path / "a.mcap", blocks))
    read = list(reader.blocks())
    assert [b.seq for b in read] == [1, 64, 3]  # not one numbered on from the other: none is joined
    assert_same_frames(read, blocks)
    assert reader.array == small_array()
    summary = reader.summary()
    assert summary.note == {"who": "test"}
    assert summary.frames == 68
    assert summary.ues == len(np.unique(np.concatenate([b.ue for b in blocks])))
    assert (summary.start_ns, summary.end_ns) == (START_NS, START_NS + 63 * MS)
    assert summary.seconds == pytest.approx(0.063)
    assert summary.closed_properly
    assert not summary.damaged


def test_the_whole_geometry_survives(tmp_path: Path) -> None:
    array = small_array(
        position_m=(1.0, 2.0, 3.0),
        axis=(1.0, 0.0, 0.0),
        broadside=(0.0, 1.0, 0.0),
        height_m=8.5,
        calibration=Calibration(
            (1, 0, 2, 3), (1.0, 0.5, 2.0, 1.0), (0.0, -1.0, 0.5, 3.0), (1.0,) * 3, (0.1,) * 3
        ),
    )
    RecordingWriter(tmp_path / "a.mcap", array).close()
    reader = RecordingReader(tmp_path / "a.mcap")
    assert reader.array == array
    assert reader.summary().frames == 0
    assert reader.summary().start_ns is None
    assert list(reader.blocks()) == []


def test_a_long_block_becomes_several_messages(tmp_path: Path) -> None:
    block = some_block(1000, seq=7)
    read = list(RecordingReader(record(tmp_path / "a.mcap", [block])).blocks())
    assert [b.seq for b in read] == list(range(7, 1007, 64))
    assert_same_frames(read, block)


def test_short_blocks_become_one_message(tmp_path: Path) -> None:
    blocks = run_of_blocks(70, frames=1)
    reader = RecordingReader(record(tmp_path / "a.mcap", blocks, chunk_bytes=50 * 96))
    read = list(reader.blocks())
    assert [(b.seq, len(b)) for b in read] == [(0, 50), (50, 20)]
    assert_same_frames(read, blocks)


@pytest.mark.parametrize("reader_class", [SeekingReader, NonSeekingReader])
def test_mcap_tools_read_it(tmp_path: Path, reader_class: type[McapReader]) -> None:
    blocks = run_of_blocks(10)
    path = record(tmp_path / "a.mcap", blocks)
    with path.open("rb") as file:
        messages = list(reader_class(file, validate_crcs=True).iter_messages(topics="csi"))
    assert [(m.log_time, m.publish_time) for _, _, m in messages] == [
        (START_NS, START_NS + 24 * MS),
        (START_NS + 25 * MS, START_NS + 49 * MS),
    ]
    assert_same_frames([decode_csi_map(m.data) for _, _, m in messages], blocks)
    assert [m.sequence for _, _, m in messages] == [0, 1]
    schema, channel, _ = messages[0]
    assert schema is not None
    assert (schema.name, channel.topic, channel.message_encoding) == ("chachart.csi", "csi", "msgpack")


def test_mcap_tools_find_its_index(tmp_path: Path) -> None:
    """Every offset in the file leads to the record that it promises."""
    path = record(tmp_path / "a.mcap", run_of_blocks(10))
    content = path.read_bytes()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == summary.statistics.chunk_count == 2
        assert summary.statistics.channel_message_counts == {1: 2}
        for chunk in summary.chunk_indexes:
            assert content[chunk.chunk_start_offset] == Opcode.CHUNK
            assert content[chunk.message_index_offsets[1]] == Opcode.MESSAGE_INDEX
            [seek] = reader.iter_messages(
                starting_at=chunk.message_start_time, ending_at=chunk.message_end_time
            )
            assert seek[2].log_time == chunk.message_start_time
        assert {m.name for m in reader.iter_metadata()} == {"chachart.csi", "chachart.totals"}
    offsets = [r for r in StreamReader(io.BytesIO(content)).records if isinstance(r, SummaryOffset)]
    assert [content[o.group_start] for o in offsets] == [o.group_opcode for o in offsets]
    assert [o.group_opcode for o in offsets] == [3, 4, 11, 8, 13]


@one_folder
@given(data=st.data())
def test_a_recording_cut_anywhere_has_all_but_its_last_chunk(
    tmp_path: Path, recorded: Recorded, data: st.DataObject
) -> None:
    cut = data.draw(st.integers(0, len(recorded.content) - 1))
    path = tmp_path / "cut.mcap"
    path.write_bytes(recorded.content[:cut])
    if cut < recorded.head_end:
        with pytest.raises(SetupError):
            RecordingReader(path)
        return
    reader = RecordingReader(path)
    read = list(reader.blocks())
    assert not reader.closed_properly
    assert reader.damaged.total() == 0
    assert frames_in(read) == recorded.complete_at(cut)
    if read:
        assert_same_frames(read, recorded.first(frames_in(read)))


def test_a_killed_writer_loses_its_last_chunk_only(tmp_path: Path) -> None:
    """A real process, killed between two writes."""
    path = tmp_path / "killed.mcap"
    code = (
        "import os, signal\n"
        "from csi_samples import small_array, some_block\n"
        "from chachart.node.files.recording import RecordingWriter\n"
        f"w = RecordingWriter({str(path)!r}, small_array(), note={{'calibrated': True}}, chunk_bytes=2048)\n"
        "for i in range(53):\n"
        "    w.write(some_block(5, seq=5 * i))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    ended = subprocess.run([sys.executable, "-c", code], env=environment, check=False)
    assert ended.returncode == -signal.SIGKILL
    reader = RecordingReader(path)
    read = list(reader.blocks())
    assert frames_in(read) == 250  # five blocks fill a chunk; the last three were on their way
    assert_same_frames(read, [some_block(5, seq=5 * i) for i in range(frames_in(read) // 5)])
    summary = reader.summary()
    assert not summary.closed_properly
    assert summary.frames == frames_in(read)
    assert summary.note == {"calibrated": True}


def test_it_can_be_read_while_it_is_written(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap", small_array()) as writer:
        writer.write(some_block(5))
        assert RecordingReader(tmp_path / "a.mcap").summary().frames == 0
        writer.flush()
        summary = RecordingReader(tmp_path / "a.mcap").summary()
        assert (summary.frames, summary.closed_properly) == (5, False)


@one_folder
@given(data=st.data())
def test_a_damaged_byte_is_noticed(tmp_path: Path, recorded: Recorded, data: st.DataObject) -> None:
    """Whatever byte is flipped: every frame that is read is one that was written, and a loss is told."""
    damaged = bytearray(recorded.content)
    damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= data.draw(st.integers(1, 255))
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    try:
        reader = RecordingReader(path)
        read = list(reader.blocks())
    except SetupError:
        return
    written = {frame.tobytes() for frame in recorded.frames.csi}
    assert all(frame.tobytes() in written for block in read for frame in block.csi)
    if frames_in(read) < len(recorded.frames) and reader.closed_properly:
        assert reader.damaged.total() == 1
        assert frames_in(read) == len(recorded.frames) - recorded.frames_per_chunk


@one_folder
@given(tail=st.binary(max_size=600), head=st.integers(0, 3000))
def test_any_bytes_are_a_recording_or_a_setup_error(
    tmp_path: Path, recorded: Recorded, head: int, tail: bytes
) -> None:
    path = tmp_path / "any.mcap"
    path.write_bytes(recorded.content[:head] + tail)
    try:
        reader = RecordingReader(path)
    except SetupError:
        return
    assert all(block.antennas == 4 for block in reader.blocks())


@one_folder
@given(start=st.integers(-20, 250), length=st.integers(0, 250), closed=st.booleans())
def test_seek_by_time_gives_exactly_those_frames(
    tmp_path: Path, recorded: Recorded, start: int, length: int, closed: bool
) -> None:
    path = tmp_path / "seek.mcap"
    path.write_bytes(recorded.content if closed else recorded.content[:-10])
    first, last = START_NS + start * MS, START_NS + (start + length) * MS
    keep = (recorded.frames.time_ns >= first) & (recorded.frames.time_ns < last)
    read = list(RecordingReader(path).blocks(first, last))
    if keep.any():
        assert_same_frames(read, recorded.frames.take(keep))
    else:
        assert read == []


def test_times_need_not_be_in_order_nor_after_1970(tmp_path: Path) -> None:
    late, early = some_block(5, start_ns=5 * MS), some_block(5, seq=5, start_ns=-10 * MS)
    reader = RecordingReader(record(tmp_path / "a.mcap", [late, early], chunk_bytes=16))
    assert_same_frames(list(reader.blocks()), [late, early])
    assert reader.start_ns == -10 * MS
    assert_same_frames(list(reader.blocks(end_ns=0)), early)
    assert_same_frames(list(reader.blocks(start_ns=0)), late)


def test_other_frames_are_refused(tmp_path: Path) -> None:
    with (
        RecordingWriter(tmp_path / "a.mcap", small_array()) as writer,
        pytest.raises(ValueError, match="4 x 3 takes no frames of 8 x 3"),
    ):
        writer.write(some_block(antennas=8))


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", run_of_blocks(1))
    before = path.read_bytes()
    with pytest.raises(SetupError, match="exists already"):
        RecordingWriter(path, small_array())
    assert path.read_bytes() == before


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"a\.mcap: No such file or directory"):
        RecordingWriter(tmp_path / "nowhere" / "a.mcap", small_array())


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"PK\x03\x04aaaaaaaa", "npz"),
        (b"MATLAB 5.0 MAT-file", "MATLAB"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
        (b"hello, world", "begins with"),
        (b"\x89MCAP0\r\n", "cut off before its description"),
    ],
)
def test_a_foreign_file_is_told(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(SetupError, match=says):
        RecordingReader(tmp_path / "a.mcap")


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"nowhere\.mcap: No such file"):
        RecordingReader(tmp_path / "nowhere.mcap")
    with pytest.raises(SetupError, match="directory"):
        RecordingReader(tmp_path)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"compression": CompressionType.LZ4}, "compressed with lz4"),
        ({"use_chunking": False, "use_statistics": False}, "holds no CSI"),
        ({"compression": CompressionType.NONE}, "holds no CSI"),
    ],
)
def test_other_mcap_files_are_told(tmp_path: Path, options: dict[str, object], says: str) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        channel = writer.register_channel("chat", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(SetupError, match=says):
        RecordingReader(path)
