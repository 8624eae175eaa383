from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from chachart.config import sample
from chachart.config.load import load
from chachart.config.registry import available
from chachart.config.settings import ArraySettings, QualitySettings, WorkersSettings
from chachart.node.commands.main import main
from chachart.node.estimation.options import Options

Write = Callable[[str], Path]
SHIPPED = sorted(Path(sample.__file__).parent.glob("*.toml"))


def test_a_whole_sample_is_the_defaults(toml_file: Write) -> None:
    settings = load(toml_file(sample.configuration()), [])
    assert settings.array == ArraySettings()
    assert settings.source.type == "simulator"
    assert settings.source == type(settings.source)()
    assert settings.estimator == Options()
    assert settings.workers == WorkersSettings()
    assert settings.quality == QualitySettings()
    assert [sink.type for sink in settings.sinks] == ["publisher"]


def uncommented(text: str) -> str:
    """With every key set that the sample only mentions, but for the name of an array that is not there."""
    return re.sub(r"^# (?!array =)(\w+ = )", r"\1", text, flags=re.MULTILINE)


def test_keys_that_are_not_set_have_fitting_examples(toml_file: Write) -> None:
    others = ("rows", "columns", "row_spacing_m", "radius_m", "elements", "file", "file_array", "up")
    lines = uncommented(sample.configuration()).splitlines()
    text = "\n".join(line for line in lines if not line.startswith(tuple(f"{name} =" for name in others)))
    settings = load(toml_file(text), ["array.broadside=x"])
    assert settings.array is not None
    assert settings.array.element_spacing_m is not None
    assert settings.estimator.isq_reference is not None


@pytest.mark.parametrize("name", available("source", package="chachart."))
def test_every_source_has_a_sample(toml_file: Write, name: str) -> None:
    text = sample.component("source", name)
    for version in (text, uncommented(text)):
        assert load(toml_file(version), []).source.type == name


@pytest.mark.parametrize("name", available("sink", package="chachart."))
def test_every_sink_has_a_sample(toml_file: Write, name: str) -> None:
    text = f"{sample.component('source', 'simulator')}\n{sample.component('sink', name)}"
    for version in (text, uncommented(text)):
        assert [sink.type for sink in load(toml_file(version), []).sinks] == [name]


def test_somebody_elses_source_has_one_too(plugins: Path, toml_file: Write) -> None:
    text = sample.component("source", "toy")
    assert "# A source for tests.\n[source]\n" in text
    assert "# Gain of the amplifier. (a number from -20 to 20)\ngain.db = 0.0" in text
    assert load(toml_file(text), []).source.type == "toy"


def test_the_table_has_every_setting_of_chachart_alone(plugins: Path) -> None:
    table = sample.table()
    for words in ("| `theta` |", "| `antennas` | a whole number from 1 to 1024 | `32` |", '`type = "zmq"`'):
        assert words in table
    assert "toy" not in table
    assert len({line.count("|") - line.count("\\|") for line in table.splitlines() if "|" in line}) == 1


def test_the_page_of_settings_has_the_table() -> None:
    page = (Path(__file__).resolve().parents[2] / "config" / "SETTINGS.md").read_text()
    begin, end = page.find(sample.TABLE_BEGINS), page.find(sample.TABLE_ENDS)
    assert page[begin : end + len(sample.TABLE_ENDS)] == sample.table()


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_configurations_have_no_mistakes(path: Path) -> None:
    assert load(path, []).source.type


def test_lab_is_the_default() -> None:
    settings = load()
    assert settings.array is not None
    assert settings.array.name == "lab"
    assert [sink.model_dump()["endpoint"] for sink in settings.sinks if sink.type == "publisher"] == [
        "tcp://127.0.0.1:5556"
    ]
    assert load(None, ["estimator.theta=music"]).estimator.theta == "music"


def test_the_command_prints_them(capsys: pytest.CaptureFixture[str]) -> None:
    for argv, expected in (
        ([], sample.configuration()),
        (["source", "zmq"], sample.component("source", "zmq")),
        (["sink", "recorder"], sample.component("sink", "recorder")),
        (["--table"], sample.table()),
    ):
        assert main(["config", *argv]) == 0
        assert capsys.readouterr().out == expected + "\n"


@pytest.mark.parametrize(
    ("argv", "words"),
    [(["source"], "which source? There are"), (["sink", "publihser"], 'did you mean "publisher"?')],
)
def test_the_command_says_what_there_is(
    argv: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", *argv]) == 78
    assert words in capsys.readouterr().err
