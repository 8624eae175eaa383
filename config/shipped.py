"""The configurations that come with chachart, by name: `lab`, `replay`, `zmq` and so on."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

from chachart.config.registry import suggestion
from chachart.node.data.errors import SetupError

_FOLDER = Path(__file__).parent
LAB = _FOLDER / "lab.toml"
"""The configuration of a node that is given none."""
PLAY = _FOLDER / "play.toml"
"""That of a node which is given a recording and nothing else."""


def names() -> list[str]:
    """Of all of them, in alphabetical order."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def find(path: Path) -> Path:
    """The configuration file that `path` names: the file if there is one, else a shipped one's name.

    Raises
    ------
    SetupError
        If there is neither.
    """
    if path.exists() or path.parent != Path():
        return path
    return text_file(path.stem if path.suffix == ".toml" else path.name)


def text_file(name: str) -> Path:
    """The file of the shipped configuration `name`.

    Raises
    ------
    SetupError
        If there is none of that name.
    """
    known = names()
    if name not in known:
        raise SetupError(
            f"there is no configuration {name}{suggestion(name, known)}; shipped are {', '.join(known)}"
        )
    return _FOLDER / f"{name}.toml"


def purpose(name: str) -> str:
    """What a shipped configuration is for: its first sentence."""
    lines = takewhile(lambda line: len(line) > 1, text_file(name).read_text("utf-8").splitlines())
    return " ".join(line.removeprefix("# ") for line in lines).partition(". ")[0].rstrip(":.")
