"""What every source must do: subclass `SourceContract` beside the source's own tests and say how to make one.

The tests talk to the real thing: `case` gives the source, not yet open, and something that makes frames come.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from typing import Any

import msgpack
import numpy as np
import pytest
from pydantic import ValidationError

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource, Source

DEADLINE_S = 20.0


def receive(source: Source, frames: int, feed: Callable[[], None] | None = None) -> list[CsiBlock]:
    """Blocks of `source` until there are so many frames or it ends; `feed` is called whenever none came."""
    blocks: list[CsiBlock] = []
    deadline = time.monotonic() + DEADLINE_S
    while sum(len(b) for b in blocks) < frames:
        assert time.monotonic() < deadline, f"only {sum(len(b) for b in blocks)} of {frames} frames came"
        try:
            block = source.recv(0.05)
        except EndOfSource:
            break
        if block is not None:
            blocks.append(block)
        elif feed is not None:
            feed()
    return blocks


@dataclass
class SourceCase:
    """A source to try.

    `name` is its entry point, `settings` its table without `type`; `feed` makes at least one more frame come
    (a source that has its own needs none); `taken` are changes that cannot be had while the source is open.
    """

    name: str
    settings: dict[str, Any]
    array: ArrayGeometry
    feed: Callable[[Source], None] = field(default=lambda source: None)
    taken: Callable[[Source], dict[str, Any] | None] = field(default=lambda source: None)

    @property
    def cls(self) -> type[Source]:
        [entry] = entry_points(group="chachart.sources", name=self.name)
        loaded: type[Source] = entry.load()
        return loaded

    def make(self, **changes: Any) -> Source:
        settings = self.cls.Settings.model_validate({"type": self.name, **self.settings, **changes})
        return self.cls(settings, self.array)

    def frames(self, source: Source, n: int) -> list[CsiBlock]:
        """At least `n` frames of an open source."""
        return receive(source, n, lambda: self.feed(source))


class SourceContract:
    """Subclass with a fixture `case` that returns a `SourceCase`."""

    @pytest.fixture
    def case(self) -> SourceCase:
        pytest.fail("a SourceContract needs a fixture `case`")

    def test_settings_have_defaults_and_name_the_source(self, case: SourceCase) -> None:
        assert case.cls.Settings.model_validate({"type": case.name}).type == case.name

    def test_settings_refuse_unknown_keys(self, case: SourceCase) -> None:
        with pytest.raises(ValidationError):
            case.cls.Settings.model_validate({"type": case.name, "no_such_key": 1})

    def test_every_setting_is_described(self, case: SourceCase) -> None:
        fields = case.cls.Settings.model_fields
        assert [name for name, info in fields.items() if name != "type" and not info.description] == []

    def test_good_settings_have_no_problems(self, case: SourceCase) -> None:
        assert case.cls.problems(case.make().settings) == []

    def test_a_carried_array_fits(self, case: SourceCase) -> None:
        carried = case.cls.carried_array(case.make().settings)
        assert carried is None or carried.mismatches(case.array) == []

    def test_blocks_are_what_the_node_expects(self, case: SourceCase) -> None:
        with case.make() as source:
            blocks = case.frames(source, 3)
        assert blocks
        for block in blocks:
            assert block.array == case.array.name
            assert (block.antennas, block.subcarriers) == (case.array.antennas, case.array.subcarriers)
            assert np.isfinite(block.csi).all()
            assert (block.time_ns > 0).all()
        assert source.rejected.as_dict() == {}

    def test_frames_are_numbered_without_gaps(self, case: SourceCase) -> None:
        with case.make() as source:
            blocks = case.frames(source, 5)
        expected = blocks[0].seq + np.cumsum([0, *(len(b) for b in blocks)])
        assert [b.seq for b in blocks] == expected[:-1].tolist()

    def test_recv_without_frames_gives_none_or_a_block_or_the_end(self, case: SourceCase) -> None:
        with case.make() as source:
            try:
                assert isinstance(source.recv(0.0), CsiBlock | None)
            except EndOfSource:
                with pytest.raises(EndOfSource):
                    source.recv(0.0)

    def test_one_that_can_go_back_goes_on_where_another_was(self, case: SourceCase) -> None:
        with case.make() as source:
            case.frames(source, 1)
            position = source.position()
            if position is None:
                return
            expected = case.frames(source, 20)
        with case.make() as source:
            source.resume(msgpack.unpackb(msgpack.packb(position)))
            assert source.position() == position
            again = case.frames(source, 20)
        assert bool(again) == bool(expected)
        if expected:
            one, other = CsiBlock.concatenate(expected), CsiBlock.concatenate(again)
            common = min(len(one), len(other))
            assert common >= 20 or len(one) == len(other)
            assert one.seq == other.seq
            for name in ("ue", "time_ns", "csi"):
                np.testing.assert_array_equal(getattr(one, name)[:common], getattr(other, name)[:common])

    def test_details_go_into_a_status_message(self, case: SourceCase) -> None:
        with case.make() as source:
            case.frames(source, 1)
            assert isinstance(msgpack.unpackb(msgpack.packb(source.details())), dict)

    def test_close_twice_and_unopened(self, case: SourceCase) -> None:
        source = case.make()
        source.close()
        source.open()
        source.close()
        source.close()

    def test_it_opens_again_after_close(self, case: SourceCase) -> None:
        for _ in range(2):
            with case.make() as source:
                assert case.frames(source, 1)

    def test_what_is_taken_is_a_problem_and_a_setup_error(self, case: SourceCase) -> None:
        with case.make() as source:
            taken = case.taken(source)
            if taken is None:
                return
            second = case.make(**taken)
            assert case.cls.problems(second.settings)
            with pytest.raises(SetupError):
                second.open()
