"""What is said where the libraries of an extra are not installed."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from chachart.node.commands.main import COMMANDS
from chachart.node.data.extras import EXTRAS

PROJECT = tomllib.loads((Path(__file__).resolve().parents[3] / "pyproject.toml").read_text())


def test_the_extras_are_those_of_the_package() -> None:
    for extra, packages in EXTRAS.items():
        listed = " ".join(PROJECT["project"]["optional-dependencies"][extra])
        assert all(package in listed for package in packages.values()), extra


@pytest.mark.parametrize(
    ("module", "arguments", "told"),
    [
        ("matplotlib", ["plot", "errors", "lab.mcap", "-o", "lab.png"], "chachart[plot]"),
        ("matplotlib", ["evaluate", "lab.mcap", "--chart", "lab.png"], "chachart[plot]"),
        ("matplotlib", ["reproduce"], "chachart[plot]"),
        ("threadpoolctl", ["bench", "quality"], "chachart[bench]"),
        ("threadpoolctl", ["reproduce"], "chachart[bench]"),
        ("cobs", ["bench", "attack", "--decoder", "stream", "--no-floods"], "chachart[serial]"),
    ],
)
def test_a_command_names_the_line_that_installs_what_it_needs(
    module: str, arguments: list[str], told: str, tmp_path: Path
) -> None:
    without = f"import sys; sys.modules.update({{{module!r}: None}})"
    code = f"{without}; from chachart.node.commands.main import main; sys.exit(main({arguments!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 78, done.stderr
    assert f'not installed: pip install "{told}"' in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_no_extra_is_needed_to_be_told_how_a_command_is_used(command: str) -> None:
    missing = {module: None for packages in EXTRAS.values() for module in packages}
    code = f"import sys; sys.modules.update({missing!r}); "
    code += f"from chachart.node.commands.main import main; main([{command!r}, '--help'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"usage: chachart {command}" in done.stdout
