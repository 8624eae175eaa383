from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csi_samples import small_array, some_block

from chachart.node.data.csi import CsiBlock
from chachart.node.runtime.partition import Partitioner, shard_of
from chachart.node.runtime.progress import Mark
from chachart.node.runtime.reader import Reader, Tally, read_tally
from chachart.node.runtime.shard_queue import ShardQueue
from chachart.node.runtime.shard_queues import ShardQueues
from chachart.sources.base import EndOfSource, Source, SourceSettings

ARRAY = small_array(4, 3)
METHOD = ("bartlett", "bartlett")
COUNTED: dict[str, Any] = {
    "frames_in": 5,
    "blocks_in": 1,
    "rejected": {},
    "gaps": 0,
    "out_of_order": 0,
    "restamped": 0,
}


class Listed(Source):
    """Gives what it was given, and notes the blocks before which it was told that a pause has to wait."""

    Settings = SourceSettings

    def __init__(self, blocks: list[CsiBlock], lossless: bool) -> None:
        super().__init__(SourceSettings(type="listed"), ARRAY)
        self.lossless = lossless
        self._blocks = blocks
        self._given = 0
        self.catching_up_at: list[int] = []

    def open(self) -> None: ...

    def recv(self, timeout: float) -> CsiBlock | None:
        if self._given == len(self._blocks):
            raise EndOfSource
        if self.catching_up:
            self.catching_up_at.append(self._given)
        self._given += 1
        return self._blocks[self._given - 1]

    def position(self) -> dict[str, Any] | None:
        return {"blocks": self._given}


def blocks(count: int, frames: int = 10, **changes: Any) -> list[CsiBlock]:
    return [some_block(frames, seq=n * frames, antennas=4, subcarriers=3, **changes) for n in range(count)]


def read(
    given: list[CsiBlock],
    shards: int = 1,
    lossless: bool = True,
    prepare: Callable[[Reader], None] = lambda reader: None,
    **options: Any,
) -> tuple[Reader, list[CsiBlock]]:
    """The reader at its end, and what it passed on, by shard."""
    queues = ShardQueues([ShardQueue(1000, 1000, lossless) for _ in range(shards)], lossless, lambda: None)
    reader = Reader(Listed(given, lossless), Partitioner(shards, 7), queues, **options)
    prepare(reader)
    reader.start()
    reader.join(30.0)
    assert reader.ended
    out = []
    for shard in range(shards):
        while (entry := queues.take(shard, METHOD, 0.0, 0)) is not None:
            out.append(entry.content.block)
    return reader, out


def test_every_frame_is_passed_on_and_counted(tmp_path: Path) -> None:
    tally = Tally(tmp_path / "tally")
    reader, out = read(blocks(5), tally=tally)
    assert sum(len(block) for block in out) == 50
    assert (reader.frames_in, reader.blocks_in, reader.passed_on) == (50, 5, 50)
    assert read_tally(tmp_path / "tally") == 50
    assert read_tally(tmp_path / "nothing") == 0


def test_marks_say_where_the_source_was() -> None:
    reader, _ = read(blocks(5))
    assert reader.marks.before(0) == Mark(0, {"blocks": 0})
    assert reader.marks.before(-1) is None


def test_frames_of_another_shape_are_counted_and_told() -> None:
    odd = some_block(4, antennas=9, subcarriers=3)
    reader, out = read([odd, *blocks(2)])
    assert reader.rejected.as_dict() == {"shape": 4}
    assert reader.complaint == "9 x 3 came, the array is 4 x 3"
    assert sum(len(block) for block in out) == 20


def test_gaps_and_late_frames_are_counted() -> None:
    first, second, third = blocks(3)
    reader, _ = read([first, third, second])
    assert reader.order.as_dict() == {"gaps": 10, "out_of_order": 10}


def test_who_goes_on_leaves_out_what_is_in_a_state_already() -> None:
    given = blocks(6)
    applied = [(2, 0, 35), (2, 1, 20)]
    reader, out = read(
        given[1:], 3, prepare=lambda reader: reader.go_on(Mark(10, {"blocks": 1}), applied, COUNTED)
    )
    everything = CsiBlock.concatenate(given)
    shard, numbers = shard_of(everything.ue, 2), np.arange(60)
    wanted = everything.take(numbers >= np.where(shard == 0, 35, 20))
    got = CsiBlock.concatenate(out)
    np.testing.assert_array_equal(np.sort(got.ue), np.sort(wanted.ue))
    assert reader.frames_in == COUNTED["frames_in"] + len(wanted)


def test_what_had_been_read_before_is_read_even_after_stop() -> None:
    def prepare(reader: Reader) -> None:
        reader.go_on(Mark(10, {"blocks": 1}), [(1, 0, 25)], COUNTED, read_before=42)
        reader.stop()

    reader, out = read(blocks(6)[1:], prepare=prepare)
    assert sum(len(block) for block in out) == 50 - 25
    assert reader.passed_on == 50, "whole blocks"


def test_the_source_is_told_that_a_pause_has_to_wait() -> None:
    source = Listed(blocks(6)[1:], lossless=True)
    queues = ShardQueues([ShardQueue(1000, 1000, True)], True, lambda: None)
    reader = Reader(source, Partitioner(1, 7), queues)
    reader.go_on(Mark(10, {"blocks": 1}), [(2, 0, 25)], COUNTED, read_before=42)
    reader.start()
    reader.join(30.0)
    assert source.catching_up_at == [0, 1, 2, 3], "from frame 10 up to 42"


def test_live_frames_of_another_day_get_the_hosts_time() -> None:
    now_ns = time.time_ns()
    good, early = blocks(2, start_ns=now_ns, step_ns=0)
    early.time_ns[3] -= int(3600e9)
    reader, out = read([good, early], lossless=False, time_tolerance_s=60.0)
    assert reader.order.as_dict() == {"restamped": 1}
    times = CsiBlock.concatenate(out).time_ns
    assert (np.abs(times - now_ns) < 60e9).all()
    reader, out = read([good, early], lossless=True, time_tolerance_s=60.0)
    assert reader.order.as_dict() == {}


def test_a_dead_antenna_of_a_live_source_has_weight_0(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("chachart.node.runtime.antenna_looks.LOOK_EVERY_S", 0.0)
    rng = np.random.default_rng(3)
    given = []
    for n in range(60):
        waves = rng.standard_normal((10, 1, 3)) * np.exp(1j * rng.uniform(0, 2 * np.pi, (10, 4, 1)))
        waves[:, 2] = 0.01 * rng.standard_normal((10, 3))
        given.append(CsiBlock.of(waves.astype(np.complex64), ue=np.arange(10), time_ns=0, seq=10 * n))
    recorded: list[CsiBlock] = []

    class Recorder:
        def put(self, block: CsiBlock) -> None:
            recorded.append(block)

    def prepare(reader: Reader) -> None:
        reader.sinks = (Recorder(),)  # type: ignore[assignment]

    reader, out = read(given, lossless=False, prepare=prepare, time_tolerance_s=1e12)
    assert reader.antennas.report()["faults"] == {"2": "dead"}
    assert list(reader.antennas.report()["dead_s"]) == ["2"]
    assert out[0].csi[:, 2].all(), "nothing is known yet"
    assert not out[-1].csi[:, 2].any()
    assert out[-1].csi[:, [0, 1, 3]].all()
    assert recorded[-1].csi.all(), "recordings keep what came"
    _, out = read(given, lossless=True)
    assert out[-1].csi.all(), "what is played again makes the same chart every time"
