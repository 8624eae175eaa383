"""One model says what an estimator can be told; code, files and type checkers read it alike."""

import subprocess
import sys
from pathlib import Path
from typing import get_type_hints

import pytest
from pydantic import TypeAdapter

from chachart.config.load import settings_of
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.options import Keywords, Options


def test_type_checkers_know_the_fields() -> None:
    assert list(Keywords.__annotations__) == list(Options.model_fields)
    keywords = get_type_hints(Keywords)
    for name, field in Options.model_fields.items():
        anything = TypeAdapter(keywords[name])
        assert anything.validate_python(field.default, strict=True) == field.default, name
        mine, theirs = TypeAdapter(field.annotation).json_schema(), anything.json_schema()
        assert kinds(mine) == kinds(theirs), name


def kinds(schema: object) -> object:
    """A JSON schema without its limits."""
    limits = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")
    if isinstance(schema, dict):
        return {key: kinds(value) for key, value in schema.items() if key not in limits}
    if isinstance(schema, list):
        return sorted((kinds(value) for value in schema), key=str)
    return schema


def test_mypy_knows_the_keywords(tmp_path: Path) -> None:
    calls = {
        'averaging="mean", signal_order="mdl", rho="isq", isq_reference=(10.0, 1.0)': None,
        'avaraging="mean"': 'Unexpected keyword argument "avaraging" for "ChartEstimator"',
        "rho=3": 'Argument "rho" to "ChartEstimator" has incompatible type',
        'theta="isq"': 'Argument "theta" to "ChartEstimator" has incompatible type',
        'max_ues="many"': 'Argument "max_ues" to "ChartEstimator" has incompatible type',
    }
    program = tmp_path / "lab.py"
    program.write_text(
        "from chachart.node.data.geometry import ArrayGeometry\n"
        "from chachart.node.estimation.estimator import ChartEstimator\n"
        "array = ArrayGeometry('lab', 8, 4, 2e9, 1e6, 0.075)\n"
        + "".join(f"ChartEstimator(array, {call})\n" for call in calls)
    )
    command = [sys.executable, "-m", "mypy", "--strict", "--no-pretty", program.name]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False).stdout
    for line, (call, complaint) in enumerate(calls.items(), start=4):
        errors = [text for text in said.splitlines() if text.startswith(f"{program.name}:{line}: error")]
        assert len(errors) == (complaint is not None), (call, said)
        assert complaint is None or complaint in errors[0], said


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("theta", "bartlet"),
        ("rho", "fft"),
        ("averaging", "median"),
        ("memory_frames", 0.5),
        ("memory_frames", float("nan")),
        ("signal_order", 0),
        ("signal_order", "aic"),
        ("order_threshold", 1.0),
        ("loading", -0.1),
        ("theta_step_deg", 0.0),
        ("rho_step_m", -1.0),
        ("rho_max_m", 0.0),
        ("newton_steps", -1),
        ("amplitude", "loud"),
        ("lr_train_ues", 1),
        ("isq_reference", (0.0, 1.0)),
        ("isq_reference", (1.0,)),
        ("forget_after_s", 0.0),
        ("max_ues", 0),
        ("theta", "joint"),
    ],
)
def test_an_argument_that_makes_no_sense_is_named(array: ArrayGeometry, name: str, value: object) -> None:
    options = {name: value}
    blamed = "rho" if value == "joint" else name
    with pytest.raises(ValueError, match=f"^{blamed} "):
        ChartEstimator(array, **options)  # type: ignore[arg-type]


def test_unknown_argument(array: ArrayGeometry) -> None:
    with pytest.raises(TypeError, match=r"^windows is not among the options: theta, rho, averaging"):
        ChartEstimator(array, windows=3)  # type: ignore[call-arg]


def test_what_is_left_to_its_default_stays_so() -> None:
    assert Options().keywords() == {}
    assert Options.of(rho="isq", isq_reference=(1.0, 2.0)).keywords() == {
        "rho": "isq",
        "isq_reference": (1.0, 2.0),
    }


def test_a_configuration_section_is_these_options() -> None:
    document = {"source": {"type": "simulator"}, "estimator": {"theta": "music", "memory_frames": 8}}
    assert settings_of(document, (), "test").estimator == Options(theta="music", memory_frames=8.0)
