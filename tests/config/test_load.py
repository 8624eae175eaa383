from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from chachart.config.load import ConfigError, NodeSettings, load

SOURCE = '[source]\ntype = "toy"\npath = "capture.bin"\n'
Write = Callable[[str], Path]


@pytest.fixture(autouse=True)
def _plugins(plugins: Path) -> None:
    """Every test here may use the toy source and sink."""


def mistakes(path: Path, *overrides: str) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        load(path, list(overrides))
    assert str(caught.value).splitlines() == list(caught.value.mistakes)
    return caught.value.mistakes


def test_a_source_alone_is_a_configuration(toml_file: Write) -> None:
    settings = load(toml_file(SOURCE), [])
    assert isinstance(settings, NodeSettings)
    assert settings.array is None
    assert settings.sinks == ()
    assert settings.source.model_dump()["path"] == Path("capture.bin")
    assert settings.estimator.theta == "bartlett"


def test_every_section(toml_file: Write) -> None:
    text = SOURCE + (
        'speed = "fast"\ngain = { db = 3, stages = 2 }\n'
        '[array]\nname = "roof"\nantennas = 8\nposition_m = [1, 2, 3]\n'
        '[estimator]\nrho = "lr"\n[workers]\ncount = 2\n[quality]\nk = 9\n'
        '[[sinks]]\ntype = "bin"\n[[sinks]]\ntype = "bin"\nendpoint = "ipc://charts"\n'
    )
    settings = load(toml_file(text), [])
    assert settings.array is not None
    assert (settings.array.name, settings.array.position_m) == ("roof", (1.0, 2.0, 3.0))
    assert settings.source.model_dump()["gain"] == {"db": 3.0, "stages": 2}
    assert (settings.estimator.rho, settings.workers.count, settings.quality.k) == ("lr", 2, 9)
    assert [s.model_dump()["endpoint"] for s in settings.sinks] == ["tcp://127.0.0.1:5556", "ipc://charts"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[estimator]\ntheta = "bartlet"', 'estimator.theta = "bartlet": must be one of "bartlett", "mvdr"'),
        ('[estimator]\ntheta = "bartlet"', 'did you mean "bartlett"?'),
        ("[estimator]\nthetta = 1", 'estimator.thetta = 1: there is no such key; did you mean "theta"?'),
        ('[array]\nantennas = "8"', 'array.antennas = "8": must be a whole number from 1 to 1024'),
        ("[array]\nantennas = true", "array.antennas = true: must be a whole number"),
        ("[array]\nantennas = 0", "array.antennas = 0: must be a whole number from 1"),
        ("[array]\nantennas = 8.5", "array.antennas = 8.5: must be a whole number"),
        ("[array]\ncarrier_hz = nan", "array.carrier_hz = nan: must be a number > 0"),
        ("[array]\nposition_m = [1, 2]", "array.position_m = [1, 2]: must be 3 numbers"),
        ('[array]\naxis = "q"', 'array.axis = "q": must be 3 numbers or one of "x", "y", "z"'),
        ("[array]\naxis = [0, 0, 0]", "array.axis = [0, 0, 0]: must not be the zero vector"),
        ('[array]\nname = "two words"', 'array.name = "two words": must be text'),
        ('[array]\naxis = "y"\nbroadside = "y"', "array: broadside (0.0, 1.0, 0.0) must be orthogonal"),
        ('[estimator]\nsignal_order = "mdll"', 'must be a whole number >= 1 or one of "threshold", "mdl"'),
        ('[estimator]\nsignal_order = "mdll"', 'did you mean "mdl"?'),
        ("[estimator]\nsignal_order = 0", "estimator.signal_order = 0: must be a whole number >= 1"),
        ('[estimator]\nrho = "joint"', 'estimator.theta = "bartlett": must be "joint" as rho is'),
        ('[estimator]\ntheta = "joint"', 'estimator.rho = "bartlett": must be "joint" as theta is'),
        ("[estimator]\nrho_step_m = 2000", "estimator.rho_step_m = 2000.0: must be at most rho_max_m = 1000"),
        ("[estimator]\nrho_step_m = 1e-9", "estimator.rho_step_m = 1e-9: must be a number >= 0.01"),
        (
            "[estimator]\ntheta_step_deg = 1e-9",
            "estimator.theta_step_deg = 1e-9: must be a number from 0.01 to",
        ),
        ("[estimator]\nmemory_frames = 0.5", "estimator.memory_frames = 0.5: must be a number >= 1"),
        (
            "[array]\nsubcarrier_spacing_hz = 312500\n[estimator]\nrho_max_m = 1000",
            "estimator.rho_max_m = 1000.0: must be at most 959.3",
        ),
        ("[array]\nsubcarriers = 1", 'estimator.rho = "bartlett": must be "isq", "lr" or "none"'),
        (
            '[array]\nantennas = 4\n[estimator]\ntheta = "music"\nsignal_order = 4',
            "estimator.signal_order = 4: must be below 4",
        ),
        ("[sorce]\nx = 1", "sorce: there is no such section, only array, source"),
        ("[sorce]\nx = 1", 'did you mean "source"?'),
        ("[sinks]\ntype = 'bin'", "sinks: must be a list of tables: [[sinks]]"),
        ("[[sinks]]\nendpoint = 'x'", "[[sinks]] number 1, type: is missing; it must be one of"),
        (
            "[[sinks]]\ntype = 'bin'\n[[sinks]]\ntype = 'bim'",
            '[[sinks]] number 2, type = "bim": there is no sink "bim"',
        ),
        ("[[sinks]]\ntype = 'bin'\nendpoint = 5", "sinks.bin.endpoint = 5: must be text"),
    ],
)
def test_a_mistake_names_key_and_value_and_what_is_allowed(
    toml_file: Write, text: str, expected: str
) -> None:
    path = toml_file(f"{SOURCE}{text}\n")
    [line] = mistakes(path)
    assert line.startswith(f"{path}: ")
    assert expected in line


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ('type = "toi"', 'source.type = "toi": there is no source "toi"'),
        ('type = "toi"', 'did you mean "toy"?'),
        ('type = "broken"', 'source "broken" cannot be loaded from toy_missing_driver:Broken'),
        ("type = 3", "source.type = 3: must be one of"),
        ('path = "x"', "source.type: is missing"),
        ('type = "toy"', "source.path: is missing; it must be a path"),
        ('type = "toy"\npath = 3', "source.path = 3: must be a path"),
        ('type = "toy"\npath = "x"\nspeed = "slow"', 'must be a number > 0 or "fast"'),
        ('type = "toy"\npath = "x"\nspeed = -1', "source.speed = -1: must be a number > 0"),
        (
            'type = "toy"\npath = "x"\ngain = { db = 99 }',
            "source.gain.db = 99: must be a number from -20 to 20",
        ),
        (
            'type = "toy"\npath = "x"\ngain = { stage = 9 }',
            "source.gain.stage = 9: there is no such key; did you",
        ),
        ('type = "toy"\npath = "x"\ngain = 4', "source.gain = 4: must be a table"),
    ],
)
def test_mistakes_in_a_source(toml_file: Write, source: str, expected: str) -> None:
    [line] = mistakes(toml_file(f"[source]\n{source}\n"))
    assert expected in line


def test_all_mistakes_at_once(toml_file: Write) -> None:
    text = '[source]\ntype = "toi"\n[array]\nantennas = 0\nsubcarriers = 0\n[workers]\ncuont = 1\n'
    lines = mistakes(toml_file(text), "estimator.theta=bartlet", "quality.every_s=0")
    assert len(lines) == 6
    for word in ("toi", "antennas", "subcarriers", "cuont", "bartlet", "every_s"):
        assert sum(word in line for line in lines) == 1


def test_no_source_at_all(toml_file: Write) -> None:
    [line] = mistakes(toml_file(""))
    assert "source.type: is missing" in line


@pytest.mark.parametrize("section", ["array", "source", "estimator", "workers", "quality"])
def test_a_section_that_is_no_table(toml_file: Write, section: str) -> None:
    lines = mistakes(toml_file(f"{section} = 3\n"))
    assert f"{section} = 3: must be a table" in "\n".join(lines)


def test_a_file_that_is_not_toml(toml_file: Write) -> None:
    [line] = mistakes(toml_file("this is not toml\n"))
    assert "node.toml: is not TOML" in line
    assert "line 1" in line


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    [line] = mistakes(tmp_path / "bad.toml")
    assert "bad.toml: cannot be read: No such file" in line
    [line] = mistakes(tmp_path)
    assert "Is a directory" in line
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'\n")
    [line] = mistakes(tmp_path / "latin.toml")
    assert "latin.toml: is not UTF-8 text" in line


def test_overrides(toml_file: Write) -> None:
    path = toml_file(f"{SOURCE}[[sinks]]\ntype = 'bin'\n")
    overrides = ["estimator.theta=music", "workers.count = 3", "sinks.0.endpoint=ipc://a", "source.gain.db=2"]
    overrides += ["source.path=other.bin", "sinks.bin.endpoint=ipc://b", "array.position_m=[0, 0, 1]"]
    settings = load(path, overrides)
    assert (settings.estimator.theta, settings.workers.count) == ("music", 3)
    assert settings.sinks[0].model_dump()["endpoint"] == "ipc://b"
    assert settings.source.model_dump()["path"] == Path("other.bin")
    assert settings.source.model_dump()["gain"]["db"] == 2.0
    assert settings.array is not None
    assert settings.array.position_m == (0.0, 0.0, 1.0)


def test_another_type_takes_the_place_of_the_whole_table(toml_file: Write) -> None:
    path = toml_file('[source]\ntype = "simulator"\nframes_per_second = 3\n')
    settings = load(path, ["source.path=x", "source.type=toy"])
    assert settings.source.model_dump()["path"] == Path("x")


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("estimator.theta=bartlet", '--set estimator.theta = "bartlet": must be one of "bartlett"'),
        ("estimator.theta", "--set estimator.theta: must look like section.key=value"),
        ("theta=music", "--set theta=music: must look like section.key=value"),
        ("estimator..theta=music", "must look like section.key=value"),
        (
            "estimator.teta=music",
            '--set estimator.teta = "music": there is no such key; did you mean "theta"?',
        ),
        ("estimater.theta=music", "there is no such section, only array"),
        ("estimator.theta.x=music", 'estimator.theta = { x = "music" }: must be one of'),
        ("source.path.x=3", "--set source.path.x=3: path is a value, not a table"),
        (
            "sinks.3.endpoint=x",
            '--set sinks.3.endpoint=x: there is no sink "3"; the configuration has bin',
        ),
        ("sinks.publisher.endpoint=x", 'there is no sink "publisher"'),
        ("sinks.bin=x", "must name a key of the sink"),
        ("sinks.bin.endpiont=x", 'sinks.bin.endpiont = "x": there is no such key; did you mean "endpoint"?'),
    ],
)
def test_mistakes_in_overrides(toml_file: Write, override: str, expected: str) -> None:
    lines = mistakes(toml_file(f"{SOURCE}[[sinks]]\ntype = 'bin'\n"), override)
    assert expected in lines[0]
    assert len(lines) == 1


def test_a_sink_type_that_occurs_twice_needs_a_number(toml_file: Write) -> None:
    path = toml_file(f"{SOURCE}[[sinks]]\ntype = 'bin'\n[[sinks]]\ntype = 'bin'\n")
    [line] = mistakes(path, "sinks.bin.endpoint=x")
    assert "several sinks" in line
    assert load(path, ["sinks.1.endpoint=x"]).sinks[1].model_dump()["endpoint"] == "x"


ZONE = """[source]
type = "simulator"
[[zones]]
name = "bay"
circle = [0, 0, 5]
"""


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (
            '[[alerts]]\nname = "a"\non = "enter"\nzone = "bya"',
            'there is no such zone in [[zones]]; did you mean "bay"?',
        ),
        ('[[alerts]]\nname = "a"\non = "enter"', 'zone must be set: on = "enter" is about one'),
        ('[[alerts]]\nname = "a"\non = "tw"', 'limit must be set for on = "tw"'),
        ('[[alerts]]\nname = "a"\non = "antenna"\nlimit = 1', 'limit means nothing for on = "antenna"'),
        ('[[zones]]\nname = "bay"\ncircle = [1, 0, 5]', '"bay" is there more than once'),
        ('[[zones]]\nname = "b"', "one of polygon and circle must be set"),
    ],
)
def test_mistakes_in_zones_and_alerts(toml_file: Write, more: str, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        load(toml_file(ZONE + more))
    assert expected in str(error.value)


def test_zones_and_alerts(toml_file: Write) -> None:
    alert = '[[alerts]]\nname = "a"\non = "enter"\nzone = "bay"\n'
    settings = load(toml_file(ZONE + alert), ["alerts.a.for_s=3", "zones.bay.circle=[1, 2, 3]"])
    assert settings.zones[0].circle == (1.0, 2.0, 3.0)
    assert (settings.alerts[0].zone, settings.alerts[0].for_s) == ("bay", 3.0)
