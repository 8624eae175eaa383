"""The house itself: every package is listed, rooms import only what they may, files stay readable."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("config", "node", "sinks", "sources")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
MODULES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))

PURE = {"calibration", "chart", "counters", "csi", "estimation", "geometry"}
"""What of chachart.node estimation may import."""
IO_MODULES = {"socket", "zmq", "asyncio", "subprocess", "multiprocessing", "threading", "pathlib", "io", "os"}


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


def test_every_package_is_listed_with_its_folder_and_typed() -> None:
    folders = {path.parent.relative_to(ROOT) for path in MODULES}
    names = {"chachart." + ".".join(folder.parts): folder.as_posix() for folder in folders}
    setuptools = PROJECT["tool"]["setuptools"]
    assert sorted(names) == sorted(setuptools["packages"])
    assert names == setuptools["package-dir"]
    for folder in folders:
        assert (ROOT / folder / "__init__.py").is_file(), folder
        assert (ROOT / folder / "py.typed").is_file(), folder


def test_the_top_level_holds_the_rooms_and_nothing_else() -> None:
    visible = {p.name for p in ROOT.iterdir() if not p.name.startswith(".")}
    made = {"build", "dist", *(p.name for p in ROOT.glob("*.egg-info"))}
    assert visible - made == {"LICENSE", "README.md", "pyproject.toml", "tests", *ROOMS}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_file_stays_readable(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 400


@pytest.mark.parametrize("path", sorted((ROOT / "node" / "estimation").rglob("*.py")), ids=name_of)
def test_estimation_knows_nothing_of_sockets_files_or_configuration(path: Path) -> None:
    for name in imports(path):
        top, *rest = name.split(".")
        assert top not in IO_MODULES, name
        if top == "chachart":
            assert rest[0] == "node", name
            assert rest[1] in PURE, name


@pytest.mark.parametrize("room", ["sources", "sinks"])
def test_sources_and_sinks_know_nothing_of_each_other_nor_of_the_runtime(room: str) -> None:
    other = {"sources": "sinks", "sinks": "sources"}[room]
    for path in (ROOT / room).rglob("*.py"):
        for name in imports(path):
            assert not name.startswith((f"chachart.{other}", "chachart.node.runtime")), f"{path}: {name}"


def test_the_readme_has_one_line_that_runs_and_one_that_tests() -> None:
    readme = (ROOT / "README.md").read_text()
    lines = [line for line in readme.splitlines() if line.startswith("python3 -m venv")]
    assert len(lines) == 2
    assert re.search(r"/chachart-node$", lines[0])
    assert re.search(r" -m pytest\b", lines[1])
