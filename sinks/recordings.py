"""The recordings in a node's recording folder, for people who want to know what is there."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from chachart.node.data.errors import RequestError, SetupError
from chachart.node.files.recording import RecordingReader

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
            files = [(path, path.stat()) for path in self.folder.glob("*.mcap") if path.is_file()]
            free = shutil.disk_usage(self.folder).free
        except OSError as error:
            raise RequestError(f"the recording folder cannot be read: {error.strerror}") from None
        files.sort(key=lambda file: -file[1].st_mtime)
        known: dict[tuple[str, int, int], dict[str, Any] | None] = {}
        listed = []
        for path, stat in files[:MOST_LISTED]:
            key = (path.name, stat.st_mtime_ns, stat.st_size)
            known[key] = self._known[key] if key in self._known else _about(path)
            if (about := known[key]) is not None:
                listed.append({"name": path.name, "size": stat.st_size, **about})
        self._known = known
        return {"folder": str(self.folder.resolve()), "free_bytes": free, "recordings": listed}

    def content(self, name: str) -> bytes:
        """A recording as it is in the folder.

        Raises
        ------
        RequestError
            If there is none of that name, or it is too large to be sent.
        """
        path = self.folder / name
        if Path(name).name != name or not name.endswith(".mcap") or not path.is_file():
            raise RequestError(f"there is no recording {name[:100]!r}")
        if path.stat().st_size > MAX_DOWNLOAD_BYTES:
            raise RequestError(f"{name} is too large to be sent; it is in {self.folder.resolve()}")
        return path.read_bytes()


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
