from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

TOY = '''
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from chachart.node.data.settings import Settings
from chachart.sinks.base import Sink, SinkSettings
from chachart.sources.base import EndOfSource, Source, SourceSettings


class GainSettings(Settings):
    db: float = Field(0.0, ge=-20, le=20)
    """Gain of the amplifier."""
    stages: int = 1
    """Amplifiers in a row."""


class ToySettings(SourceSettings):
    """A source for tests."""

    type: Literal["toy"] = "toy"
    path: Path
    """What it plays."""
    speed: Annotated[float, Field(gt=0)] | Literal["fast"] = 1.0
    """How fast it plays."""
    gain: GainSettings = GainSettings()
    """The amplifier."""


class Toy(Source):
    Settings = ToySettings

    def open(self):
        pass

    def recv(self, timeout):
        raise EndOfSource


class BinSettings(SinkSettings):
    """A sink for tests."""

    type: Literal["bin"] = "bin"
    endpoint: str = "tcp://127.0.0.1:5556"
    """Where it goes."""


class Bin(Sink):
    Settings = BinSettings
'''

ENTRY_POINTS = """
[chachart.sources]
toy = toy_plugin:Toy
broken = toy_missing_driver:Broken
nameless = toy_plugin:Nameless
nonsense = toy_plugin:BinSettings
twice = toy_plugin:Toy

[chachart.sinks]
bin = toy_plugin:Bin
"""


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Two installed packages of somebody else: a toy source and sink, and several that do not load."""
    site = tmp_path / "site"
    for name, entries in (("toy", ENTRY_POINTS), ("other", "[chachart.sources]\ntwice = other:Twice\n")):
        info = site / f"{name}-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entries)
    (site / "toy_plugin.py").write_text(TOY)
    monkeypatch.syspath_prepend(str(site))
    yield site
    sys.modules.pop("toy_plugin", None)


@pytest.fixture
def toml_file(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a configuration and says where."""

    def write(text: str) -> Path:
        path = tmp_path / "node.toml"
        path.write_text(text)
        return path

    return write
