"""Names of the files that sinks write: patterns with a time, and a number where a name is taken."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

from chachart.node.data.errors import SetupError

MOST_FILES = 100_000


def file_name(pattern: Path, now: datetime | None = None) -> Path:
    """`pattern` with `{time}` replaced by the UTC time, as in `20260131T235959Z`."""
    stamp = (now or datetime.now(UTC)).strftime("%Y%m%dT%H%M%SZ")
    return pattern.with_name(pattern.name.replace("{time}", stamp))


def free_name(pattern: Path) -> Path:
    """`file_name` of a file that does not exist yet: `csi.mcap`, then `csi-2.mcap`, `csi-3.mcap` ...

    Raises
    ------
    SetupError
        If there are 100 000 such files already.
    """
    path = first = file_name(pattern)
    number = 1
    while os.path.lexists(path):
        number += 1
        if number > MOST_FILES:
            raise SetupError(f"{first} and {MOST_FILES - 1} numbered files beside it exist already")
        path = first.with_stem(f"{first.stem}-{number}")
    return path


def write_problems(pattern: Path) -> list[str]:
    """What would keep a file of that name from being written."""
    path = file_name(pattern)
    folder = path.parent
    if not folder.is_dir():
        return [f"cannot write {path}: the folder {folder} does not exist"]
    if path.is_dir():
        return [f"cannot write {path}: it is a folder"]
    if not os.access(path if path.exists() else folder, os.W_OK):
        return [f"cannot write {path}: permission denied"]
    return []
