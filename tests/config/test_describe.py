from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from chachart.config.describe import allowed, toml
from chachart.node.data.settings import Means, Settings


class Example(Settings):
    flag: bool = True
    count: int = Field(3, ge=1, le=64)
    ratio: float = Field(0.5, gt=0, lt=1)
    large: float = Field(1.0, le=10e6)
    huge: float = Field(1.0, le=2e12)
    step: float | None = Field(None, gt=0)
    name: Annotated[str, Means("that begins with an a")] = Field("a", min_length=1, pattern="^a")
    short: str = Field("a", max_length=8)
    file: Path = Path("x")
    kind: Literal["a", "b"] = "a"
    only: Literal["a"] = "a"
    either: Annotated[float, Field(ge=0)] | Literal["auto"] = "auto"
    where: tuple[float, float, float] = (0, 0, 0)
    pair: tuple[str, int] = ("a", 1)
    names: list[str] = Field(default_factory=list)
    table: dict[str, int] = Field(default_factory=dict)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("flag", "true or false"),
        ("count", "a whole number from 1 to 64"),
        ("ratio", "a number > 0 and < 1"),
        ("large", "a number <= 10000000"),
        ("huge", "a number <= 2e12"),
        ("step", "a number > 0"),
        ("name", "text that begins with an a"),
        ("short", "text at most 8 long"),
        ("file", "a path"),
        ("kind", 'one of "a", "b"'),
        ("only", '"a"'),
        ("either", 'a number >= 0 or "auto"'),
        ("where", "3 numbers"),
        ("pair", "[text, a whole number]"),
        ("names", "a list (of text each)"),
        ("table", "a table"),
    ],
)
def test_what_a_field_allows(name: str, words: str) -> None:
    assert allowed(Example.model_fields[name]) == words


values = st.recursive(
    st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=8,
)


@given(values)
def test_values_survive_as_toml(value: Any) -> None:
    assert tomllib.loads(f"value = {toml(value)}")["value"] == value


def test_numbers_are_short() -> None:
    assert [toml(v) for v in (2e9, 9765.625, 1000.0, 1e-5, 299792458.0)] == [
        "2e9",
        "9765.625",
        "1000.0",
        "1e-5",
        "299792458.0",
    ]


def test_what_toml_cannot_say() -> None:
    with pytest.raises(TypeError, match="no place in a TOML file"):
        toml(object())
