"""What every sink must do: subclass `SinkContract` beside the sink's own tests and say how to make one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from typing import Any

import pytest
from chart_samples import QUALITY, STATUS, StillNode, some_chart
from csi_samples import some_block
from pydantic import ValidationError

from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sinks.base import Sink


@dataclass
class SinkCase:
    """A sink to try.

    `name` is its entry point, `settings` its table without `type`, `impossible` changes with which it cannot
    open, `taken` changes that cannot be had while the given sink is open.
    """

    name: str
    settings: dict[str, Any]
    array: ArrayGeometry
    impossible: dict[str, Any] | None = None
    taken: Callable[[Sink], dict[str, Any] | None] = field(default=lambda sink: None)

    @property
    def cls(self) -> type[Sink]:
        [entry] = entry_points(group="chachart.sinks", name=self.name)
        loaded: type[Sink] = entry.load()
        return loaded

    def make(self, **changes: Any) -> Sink:
        settings = self.cls.Settings.model_validate({"type": self.name, **self.settings, **changes})
        return self.cls(settings, self.array)

    def open(self, node: StillNode | None = None) -> Sink:
        sink = self.make()
        sink.open(None if sink.wants_csi else node or StillNode(some_chart(), QUALITY))
        return sink


def give_everything(sink: Sink) -> None:
    """All that a node gives a sink, once."""
    sink.on_tick()
    if sink.wants_csi:
        sink.on_csi(some_block(3, antennas=sink.array.antennas, subcarriers=sink.array.subcarriers))
    else:
        sink.on_chart(some_chart(7, first_ue=3))
        sink.on_chart(some_chart(1, position=False))
        sink.on_quality(QUALITY)
        sink.on_status(STATUS)
    sink.on_tick()


class SinkContract:
    """Subclass with a fixture `case` that returns a `SinkCase`."""

    @pytest.fixture
    def case(self) -> SinkCase:
        pytest.fail("a SinkContract needs a fixture `case`")

    def test_settings_have_defaults_and_name_the_sink(self, case: SinkCase) -> None:
        assert case.cls.Settings.model_validate({"type": case.name}).type == case.name

    def test_settings_refuse_unknown_keys(self, case: SinkCase) -> None:
        with pytest.raises(ValidationError):
            case.cls.Settings.model_validate({"type": case.name, "no_such_key": 1})

    def test_every_setting_is_described(self, case: SinkCase) -> None:
        fields = case.cls.Settings.model_fields
        assert [name for name, info in fields.items() if name != "type" and not info.description] == []

    def test_good_settings_have_no_problems(self, case: SinkCase) -> None:
        assert case.cls.problems(case.make().settings) == []

    def test_it_takes_everything_and_says_where(self, case: SinkCase) -> None:
        sink = case.open()
        give_everything(sink)
        assert isinstance(sink.where(), str)
        sink.close()

    def test_nothing_comes_at_all(self, case: SinkCase) -> None:
        sink = case.open(StillNode())
        sink.on_tick()
        sink.close()
        assert isinstance(sink.where(), str | None)

    def test_close_twice_and_unopened(self, case: SinkCase) -> None:
        case.make().close()
        sink = case.open()
        give_everything(sink)
        sink.close()
        sink.close()

    def test_it_opens_again_after_close(self, case: SinkCase) -> None:
        for _ in range(2):
            sink = case.open()
            give_everything(sink)
            sink.close()

    def test_what_is_impossible_is_a_problem_and_a_setup_error(self, case: SinkCase) -> None:
        if case.impossible is not None:
            self._refused(case, case.impossible)

    def test_what_is_taken_is_a_problem_and_a_setup_error(self, case: SinkCase) -> None:
        sink = case.open()
        taken = case.taken(sink)
        if taken is not None:
            self._refused(case, taken)
        sink.close()

    def _refused(self, case: SinkCase, changes: dict[str, Any]) -> None:
        sink = case.make(**changes)
        assert case.cls.problems(sink.settings)
        with pytest.raises(SetupError):
            sink.open(None if sink.wants_csi else StillNode())
