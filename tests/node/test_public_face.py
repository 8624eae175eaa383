"""`chachart.node` as a library."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

import chachart.node


def test_every_public_name_is_there_and_listed() -> None:
    for name in chachart.node.__all__:
        assert getattr(chachart.node, name) is not None
    assert dir(chachart.node) == sorted(chachart.node.__all__)
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", chachart.node.__version__)


def test_other_names_are_told() -> None:
    with pytest.raises(AttributeError, match=r"Estimator.*it has .*ChartEstimator"):
        chachart.node.Estimator  # noqa: B018


def test_a_name_is_imported_when_it_is_asked_for() -> None:
    code = (
        "import sys, chachart.node\n"
        "assert not [m for m in sys.modules if m.startswith('chachart.node.')]\n"
        "from chachart.node import ArrayGeometry\n"
        "assert 'zmq' not in sys.modules and 'chachart.node.estimation' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("program", ["main", "node"])
def test_commands_say_their_version(program: str) -> None:
    command = [sys.executable, "-m", f"chachart.node.commands.{program}", "--version"]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert chachart.node.__version__ in told
