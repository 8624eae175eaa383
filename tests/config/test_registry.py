from __future__ import annotations

import sys
from pathlib import Path

import pytest

from chachart.config.registry import available, settings_class, sink_class, source_class
from chachart.node.data.errors import SetupError


def test_names_of_every_installed_package(plugins: Path) -> None:
    assert {"simulator", "recording", "zmq", "toy"} <= set(available("source"))
    assert {"publisher", "recorder", "bin"} <= set(available("sink"))
    assert "toy" not in available("source", package="chachart.")


def test_loaded_when_asked_for_and_not_before(plugins: Path) -> None:
    assert "toy_plugin" not in sys.modules
    assert source_class("toy").__name__ == "Toy"
    assert sink_class("bin").__name__ == "Bin"
    assert settings_class("source", "toy").__name__ == "ToySettings"
    assert settings_class("sink", "bin").__name__ == "BinSettings"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("tyo", ['no source "tyo"', '"simulator"', 'did you mean "toy"?']),
        ("broken", ["toy_missing_driver:Broken", "ModuleNotFoundError", "toy_missing_driver"]),
        ("nameless", ["toy_plugin:Nameless", "AttributeError"]),
        ("nonsense", ["is no chachart.sources.base.Source"]),
        ("twice", ["more than once", "other:Twice", "toy_plugin:Toy"]),
    ],
)
def test_a_source_that_cannot_be_had_is_told_why(plugins: Path, name: str, words: list[str]) -> None:
    with pytest.raises(SetupError) as caught:
        source_class(name)
    for word in words:
        assert word in str(caught.value)


def test_an_unknown_sink_lists_what_there_is(plugins: Path) -> None:
    with pytest.raises(SetupError, match=r'no sink "publihser".*did you mean "publisher"'):
        sink_class("publihser")
