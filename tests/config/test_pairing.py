from __future__ import annotations

from typing import Any

import pytest

from chachart.config.load import ConfigError, NodeSettings, settings_of

NORTH, EAST = {"name": "north"}, {"name": "east"}


def _settings(arrays: list[dict[str, Any]], sources: list[dict[str, Any]], *changes: str) -> NodeSettings:
    document = {"array": arrays, "source": [{"type": "zmq", **source} for source in sources]}
    return settings_of(document, changes, "test")


def _pairs(settings: NodeSettings) -> list[list[str]]:
    return [[array.name for array in feed.arrays] for feed in settings.feeds]


def test_sources_measure_with_the_arrays_in_the_same_places() -> None:
    assert _pairs(_settings([NORTH, EAST], [{}, {}])) == [["north"], ["east"]]


def test_sources_say_which_arrays_they_measure_with() -> None:
    named = _settings([NORTH, EAST], [{"array": "east"}, {"array": "north"}])
    assert _pairs(named) == [["east"], ["north"]]
    assert _pairs(_settings([NORTH, EAST], [{"array": ["north", "east"]}])) == [["north", "east"]]


def test_one_table_of_each_stays_what_it_was() -> None:
    settings = settings_of({"array": {"name": "lab"}, "source": {"type": "zmq"}}, [], "test")
    assert settings.array is not None
    assert settings.array.name == "lab"
    assert settings_of({"array": {}, "source": {"type": "zmq"}}, [], "test").array is not None
    assert settings_of({"source": {"type": "zmq"}}, [], "test").array is None


def test_one_of_several_is_changed_by_its_name_type_or_number() -> None:
    changed = _settings(
        [NORTH, EAST], [{}, {}], "array.east.antennas=4", "array.0.antennas=2", "source.1.queue_blocks=3"
    )
    antennas = [array.antennas for feed in changed.feeds for array in feed.arrays]
    assert antennas == [2, 4]
    assert [feed.source.model_dump()["queue_blocks"] for feed in changed.feeds] == [16, 3]


@pytest.mark.parametrize(
    ("arrays", "sources", "expected"),
    [
        ([NORTH, NORTH], [{}, {}], "names must be different"),
        ([NORTH, EAST], [{}], '"east": no source measures with it'),
        ([NORTH], [{"array": "north"}, {"array": "north"}], '"north": 2 sources measure with it'),
        ([NORTH], [{"array": "south"}], 'array = "south": must be one of "north"'),
        ([{"name": "north", "antennas": 0}, EAST], [{}, {}], "array.north.antennas = 0: must be"),
        (
            [NORTH, {"name": "east", "rows": 2, "antennas": 3, "columns": 2}],
            [{}, {}],
            "array.east: antennas = 3",
        ),
        ([NORTH, EAST], [{"queue_blocks": 0}, {}], "[[source]] number 1, queue_blocks = 0"),
    ],
)
def test_what_does_not_go_together_is_told(
    arrays: list[dict[str, Any]], sources: list[dict[str, Any]], expected: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        _settings(arrays, sources)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("array.south.antennas=4", 'there is no array "south"; the configuration has north, east'),
        ("source.zmq.queue_blocks=4", 'several sources are "zmq", say which by its number'),
        ("array.antennas=4", 'there is no array "antennas"'),
    ],
)
def test_a_change_of_one_that_is_not_there_is_told(change: str, expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        _settings([NORTH, EAST], [{}, {}], change)
    assert expected in str(caught.value)
