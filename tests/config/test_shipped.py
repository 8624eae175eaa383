from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from chachart.config import shipped
from chachart.config.load import ConfigError, load
from chachart.node.commands.main import main


@pytest.mark.parametrize("name", shipped.names())
def test_every_one_shows_itself_and_can_be_steered(name: str) -> None:
    document = tomllib.loads(shipped.text_file(name).read_text())
    assert {"view", "control"} <= {sink["type"] for sink in document["sinks"]}
    assert len(shipped.purpose(name)) > 20


def test_they_are_found_by_name_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load(Path("replay")).source.type == "recording"
    assert load(Path("zmq.toml")).source.type == "zmq"
    (tmp_path / "zmq.toml").write_text('[source]\ntype = "simulator"')
    assert load(Path("zmq.toml")).source.type == "simulator", "a file goes before a name"
    with pytest.raises(ConfigError, match='no configuration replya; did you mean "replay"'):
        load(Path("replya"))
    with pytest.raises(ConfigError, match="cannot be read"):
        load(Path("elsewhere/replay.toml"))


def test_sinks_can_be_added(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text('[source]\ntype = "simulator"\n[[sinks]]\ntype = "control"')
    settings = load(path, ["sinks.view.port=8099"], ["view", "control", "view"])
    assert [sink.type for sink in settings.sinks] == ["control", "view"]
    assert settings.sinks[1].model_dump()["port"] == 8099
    with pytest.raises(ConfigError, match=r'no sink "veiw".*did you mean "view"'):
        load(path, [], ["veiw"])


def test_the_command_lists_and_shows_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == shipped.names()
    assert main(["config", "show", "replay"]) == 0
    assert capsys.readouterr().out == shipped.text_file("replay").read_text()
    assert main(["config", "show", "nothing"]) == 78
    assert "shipped are" in capsys.readouterr().err
    assert main(["config", "show"]) == 78
