"""Recordings whose chunks are compressed: read as others are, by others' tools too, and bounded."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import zstandard
from csi_samples import START_NS, assert_same_frames, small_array, some_block
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.files.recording import RecordingReader, RecordingWriter
from chachart.node.net.wire import decode_csi_map

FRAMES = 200
one_folder = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def whole_numbers() -> CsiBlock:
    """Samples as Wi-Fi tools give them: small whole numbers."""
    rng = np.random.default_rng(0)
    csi = rng.integers(-40, 40, (FRAMES, 4, 8, 2)).astype(np.float32).view(np.complex64)[..., 0]
    block = some_block(FRAMES, start_ns=START_NS)
    return CsiBlock(block.array, 0, block.ue, block.time_ns, np.ascontiguousarray(csi), block.position)


def record(path: Path, block: CsiBlock, *, zstd: bool = True) -> Path:
    array = small_array(antennas=block.antennas, subcarriers=block.subcarriers)
    with RecordingWriter(path, array, zstd=zstd, chunk_bytes=8192) as writer:
        writer.write(block)
    return path


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record(tmp_path_factory.mktemp("packed") / "a.mcap", whole_numbers()).read_bytes()


def test_it_is_shorter_and_read_as_it_was_written(tmp_path: Path, content: bytes) -> None:
    block = whole_numbers()
    plain = record(tmp_path / "plain.mcap", block, zstd=False)
    assert len(content) < 0.5 * plain.stat().st_size
    (tmp_path / "a.mcap").write_bytes(content)
    reader = RecordingReader(tmp_path / "a.mcap")
    assert reader.closed_properly
    assert_same_frames(list(reader.blocks()), block)
    with (tmp_path / "a.mcap").open("rb") as file:
        others = [
            decode_csi_map(message.data)
            for _, _, message in make_reader(file, validate_crcs=True).iter_messages()
        ]
    assert_same_frames(others, block)


@one_folder
@given(at=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
def test_a_damaged_byte_is_noticed(tmp_path: Path, content: bytes, at: float, flip: int) -> None:
    damaged = bytearray(content)
    damaged[int(at * len(damaged))] ^= flip
    (tmp_path / "a.mcap").write_bytes(damaged)
    try:
        reader = RecordingReader(tmp_path / "a.mcap")
        read = list(reader.blocks())
    except SetupError:
        return
    written = {frame.tobytes() for frame in whole_numbers().csi}
    assert all(frame.tobytes() in written for block in read for frame in block.csi)
    if sum(map(len, read)) < FRAMES and reader.closed_properly:
        assert reader.damaged.total() == 1


def test_a_chunk_unpacks_to_no_more_than_it_says(tmp_path: Path, content: bytes) -> None:
    """A bomb of the length of the first chunk in its place, which says the same size."""
    chunk = next(
        r for r in StreamReader(io.BytesIO(content), emit_chunks=True).records if isinstance(r, Chunk)
    )
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 20))
    at = content.index(chunk.data)
    bomb += bytes(len(chunk.data) - len(bomb))
    (tmp_path / "a.mcap").write_bytes(content[:at] + bomb + content[at + len(bomb) :])
    reader = RecordingReader(tmp_path / "a.mcap")
    read = sum(len(block) for block in reader.blocks())
    assert reader.damaged.as_dict() == {"chunk_compression": 1}
    assert 0 < read < FRAMES
