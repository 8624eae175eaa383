"""Which chachart this is: the version, and the commit it was built from or runs in."""

from __future__ import annotations

import subprocess
from functools import cache
from importlib.metadata import version
from pathlib import Path

__version__ = version("chachart")

COMMIT_FILE = "commit.txt"
"""Beside this file, where setup.py wrote it into a build from a checkout."""


@cache
def build() -> str:
    """The version and, where it is known, the commit: `0.1.0 (15e7dc4)`."""
    commit = _commit()
    return f"{__version__} ({commit})" if commit else __version__


def _commit() -> str:
    here = Path(__file__).resolve()
    built = here.with_name(COMMIT_FILE)
    if built.exists():
        return built.read_text("ascii").strip()
    root = here.parents[2]
    if not (root / "pyproject.toml").exists() or not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--exclude", "*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
