"""The recordings in a node's recording folder, for people who want to know what is there."""

from __future__ import annotations

import os
import re
import shutil
import stat
from pathlib import Path
from typing import Any

from chachart.node.data.errors import RequestError, SetupError
from chachart.node.files.recording import RecordingReader

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*\.mcap")
"""What a recording in the folder is called; links are none, wherever they lead."""
MOST_LISTED = 200
MAX_DOWNLOAD_BYTES = 256 * 1024**2
"""A download is held in memory as a whole."""


class Recordings:
    """What is in `folder`; a file that has not changed is looked into once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[tuple[str, int, int], dict[str, Any] | None] = {}

    def list(self) -> dict[str, Any]:
        """`{folder, free_bytes, recordings: [{name, size, frames, ues, seconds, ...}]}`, newest first."""
        try:
            paths = [path for path in self.folder.glob("*.mcap") if NAME.fullmatch(path.name)]
            files = [(path, path.stat()) for path in paths if path.is_file() and not path.is_symlink()]
            free = shutil.disk_usage(self.folder).free
        except OSError as error:
            raise RequestError(f"the recording folder cannot be read: {error.strerror}") from None
        files.sort(key=lambda file: -file[1].st_mtime)
        known: dict[tuple[str, int, int], dict[str, Any] | None] = {}
        listed = []
        for path, state in files[:MOST_LISTED]:
            key = (path.name, state.st_mtime_ns, state.st_size)
            known[key] = self._known[key] if key in self._known else _about(path)
            if (about := known[key]) is not None:
                listed.append({"name": path.name, "size": state.st_size, **about})
        self._known = known
        return {"folder": str(self.folder.resolve()), "free_bytes": free, "recordings": listed}

    def content(self, name: str) -> bytes:
        """A recording as it is in the folder.

        Raises
        ------
        RequestError
            If there is none of that name, or it is too large to be sent.
        """
        missing = RequestError(f"there is no recording {name[:100]!r}")
        if not NAME.fullmatch(name):
            raise missing
        try:
            fd = os.open(self.folder / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError:
            raise missing from None
        with open(fd, "rb") as file:
            state = os.fstat(fd)
            if not stat.S_ISREG(state.st_mode):
                raise missing
            if state.st_size > MAX_DOWNLOAD_BYTES:
                raise RequestError(f"{name} is too large to be sent; it is in {self.folder.resolve()}")
            return file.read(MAX_DOWNLOAD_BYTES)


def _about(path: Path) -> dict[str, Any] | None:
    """What is in a recording; None where the file is none. One that still grows has no totals yet."""
    try:
        reader = RecordingReader(path)
        totals = reader.summary() if reader.closed_properly else None
    except SetupError:
        return None
    start, end, array = reader.start_ns, reader.end_ns, reader.array
    return {
        "frames": None if totals is None else totals.frames,
        "ues": None if totals is None else totals.ues,
        "seconds": 0.0 if start is None or end is None else (end - start) / 1e9,
        "array": array.name,
        "antennas": array.antennas,
        "subcarriers": array.subcarriers,
        "closed": reader.closed_properly,
    }
