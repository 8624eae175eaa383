"""Whether the libraries behind a link are there."""

from __future__ import annotations

from importlib.util import find_spec

from chachart.node.data.errors import SetupError

LIBRARIES = {
    "serial": {"serial": "pyserial", "cobs": "cobs"},
    "can": {"can": "python-can", "isotp": "can-isotp"},
}
"""By extra of chachart: module and the package it comes in."""


def missing(extra: str) -> list[str]:
    """What to say of the libraries of an extra that are not installed; nothing if all are."""
    packages = [package for module, package in LIBRARIES[extra].items() if find_spec(module) is None]
    if not packages:
        return []
    return [f'{" and ".join(packages)} not installed: pip install "chachart[{extra}]"']


def require(extra: str) -> None:
    """Make sure that the libraries of an extra are there.

    Raises
    ------
    SetupError
        If not.
    """
    for problem in missing(extra):
        raise SetupError(f"[source] {problem}")
