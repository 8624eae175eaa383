"""The house itself: every package is listed, rooms import only what they may, files stay readable."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("config", "node", "sinks", "sources")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
MODULES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))

BELOW = {
    "node.data": set[str](),
    "node.estimation": {"node.data"},
    "node.net": {"node.data"},
    "node.files": {"node.data", "node.net"},
    "sources": {"node.data", "node.estimation", "node.net", "node.files"},
    "sinks": {"node.data", "node.estimation", "node.net", "node.files"},
    "config": {"node.data", "node.estimation", "node.net", "node.files", "sources", "sinks"},
}
BELOW["node.runtime"] = {*BELOW, "config"}
BELOW["node.commands"] = {*BELOW, "node.runtime"}
"""What each floor may import of chachart beside itself. Floors that import each other would make a circle, so
the test that this table has none and the test that files obey it together keep the house free of them."""

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
    assert visible - made == {"LICENSE", "README.md", "pyproject.toml", "setup.py", "tests", *ROOMS}


@pytest.mark.parametrize(
    "path",
    [*MODULES, *(ROOT / "tests").rglob("*.py"), *(ROOT / "sinks/view/page").iterdir()],
    ids=name_of,
)
def test_a_file_stays_readable(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 350


def floor_of(module: str) -> str:
    """The floor of a dotted name below chachart: `node.data` of `node.data.csi`, `sinks` of `sinks.view`."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "node" else parts[0]


def forbidden(module: str, imported: set[str]) -> list[str]:
    """Which of the modules that `module` imports stand on no floor below its own."""
    own = floor_of(module)
    names = {name.removeprefix("chachart.") for name in imported if name.startswith("chachart.")}
    return sorted(name for name in names if floor_of(name) not in {own, *BELOW[own]})


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_file_imports_only_its_own_floor_and_those_below(path: Path) -> None:
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    if module != "node.__init__":  # the public face: names of all floors, imported when asked for
        assert forbidden(module, imports(path)) == []


@pytest.mark.parametrize("floor", BELOW)
def test_no_floor_is_below_itself(floor: str) -> None:
    reached, ahead = set[str](), {floor}
    while ahead:
        ahead = {below for step in ahead for below in BELOW[step]} - reached
        reached |= ahead
    assert floor not in reached


def test_an_import_upwards_is_noticed() -> None:
    upwards = {"chachart.sinks.base", "chachart.node.data.csi", "numpy"}
    assert forbidden("sources.zmq", upwards) == ["sinks.base"]
    assert forbidden("node.estimation.joint", {"chachart.node.runtime.node"}) == ["node.runtime.node"]
    assert forbidden("sinks.view.hub", {"chachart.config.load"}) == ["config.load"]


def test_no_file_lies_loose_in_node() -> None:
    assert [path.name for path in (ROOT / "node").glob("*.py")] == ["__init__.py"]


@pytest.mark.parametrize("path", sorted((ROOT / "node" / "estimation").rglob("*.py")), ids=name_of)
def test_estimation_knows_nothing_of_sockets_and_files(path: Path) -> None:
    assert not {name.split(".")[0] for name in imports(path)} & IO_MODULES


def test_the_readme_has_one_line_that_runs_and_one_that_tests() -> None:
    readme = (ROOT / "README.md").read_text()
    lines = [line for line in readme.splitlines() if line.startswith("python3 -m venv")]
    assert len(lines) == 2
    assert re.search(r"/chachart-node$", lines[0])
    assert re.search(r" -m pytest\b", lines[1])


def test_ray_is_loaded_by_nobody_who_does_without_it() -> None:
    code = "import sys, chachart.node.commands.node, chachart.node.runtime.node; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "chachart.node.runtime.worker_pool" in loaded.stdout.split()
    assert "ray" not in loaded.stdout.split()


def test_a_worker_loads_little_of_scipy() -> None:
    """Its `signal`, `stats` and `optimize` take 50 MB of each process and half a second of its start."""
    code = "import sys, chachart.node.runtime.worker; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"scipy.signal", "scipy.stats", "scipy.optimize"} & set(loaded.stdout.split())
