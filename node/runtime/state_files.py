"""The files of `[state] directory`: numbered snapshots of which the newest two are kept.

A run has a folder of its own; `--resume` goes on in the newest. In it are `node-<n>.snapshot`, of the main
process, and `worker-<shard>-of-<count>-<n>.snapshot`.
"""

from __future__ import annotations

import logging
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from chachart.node.files.snapshots import SnapshotError, read_facts, read_snapshot, write_snapshot

log = logging.getLogger(__name__)

KEPT = 2
NODE = "node"
_SHARD = re.compile(r"worker-(\d+)-of-(\d+)-\d+\.snapshot")
_RUN = re.compile(r"run-\d{8}T\d{6}Z(-\d+)?")


class Series:
    """Snapshots of one thing, in the order of their numbers.

    Parameters
    ----------
    folder, name
        Where they are, and what they are called before the number.
    durable
        Whether they must outlive the machine.
    """

    def __init__(self, folder: Path, name: str, durable: bool) -> None:
        self._folder = folder
        self._name = name
        self._durable = durable

    def newest(self) -> Iterator[tuple[Path, dict[str, Any], dict[str, NDArray[Any]]]]:
        """Those that can be read, newest first; those that cannot are complained about."""
        for path in reversed(self._paths()):
            try:
                yield path, *read_snapshot(path)
            except SnapshotError as error:
                log.warning("%s; the one before it is taken", error)

    def newest_facts(self) -> dict[str, Any] | None:
        """The facts of the newest one that can be read, or None."""
        for path in reversed(self._paths()):
            try:
                return read_facts(path)
            except SnapshotError as error:
                log.warning("%s; the one before it is taken", error)
        return None

    def forget_unfinished(self) -> None:
        """What others were writing when they died must not appear any more."""
        forget_unfinished(self._folder, self._name)

    def write(
        self,
        facts: dict[str, Any],
        arrays: Iterable[tuple[str, NDArray[Any]]],
        wanted: Callable[[], bool] = lambda: True,
    ) -> Path:
        """Write the next one, unless it is not `wanted` in the end, and let go of those that are not kept.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        paths = self._paths()
        number = 1 + (int(paths[-1].stem.rpartition("-")[2]) if paths else 0)
        path = self._folder / f"{self._name}-{number:08d}.snapshot"
        write_snapshot(path, facts, arrays, self._durable, wanted)
        for old in paths[: 1 - KEPT]:
            with suppress(OSError):
                old.unlink()
        return path

    def _paths(self) -> list[Path]:
        return sorted(self._folder.glob(f"{self._name}-{'[0-9]' * 8}.snapshot"))


def forget_unfinished(folder: Path, name: str = "") -> None:
    """Take away the snapshots that are being written, so that none of them gets its name any more."""
    for path in folder.glob(f"{name}*.snapshot.new"):
        with suppress(OSError):
            path.unlink()


def worker_series(folder: Path, shard: int, count: int, durable: bool) -> Series:
    """The snapshots of one worker."""
    return Series(folder, f"worker-{shard}-of-{count}", durable)


def other_counts(folder: Path, count: int) -> list[int]:
    """For which other numbers of workers there is a snapshot of each, newest first."""
    newest: dict[int, dict[int, float]] = {}
    for path in folder.glob("worker-*.snapshot"):
        if (match := _SHARD.fullmatch(path.name)) and int(match[2]) != count:
            shards = newest.setdefault(int(match[2]), {})
            shards[int(match[1])] = max(shards.get(int(match[1]), 0.0), path.stat().st_mtime)
    whole = [n for n, shards in newest.items() if len(shards) == n]
    return sorted(whole, key=lambda n: max(newest[n].values()), reverse=True)


def runs(directory: Path) -> list[Path]:
    """The folders of all runs, oldest first."""
    return sorted(path for path in directory.glob("run-*") if _RUN.fullmatch(path.name) and path.is_dir())


def new_run(directory: Path) -> Path:
    """A folder for a new run; of those before only the last is kept.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    directory.mkdir(parents=True, exist_ok=True)
    before = runs(directory)
    stamp = f"run-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    number, folder = 1, directory / stamp
    while folder.exists():
        number += 1
        folder = directory / f"{stamp}-{number}"
    folder.mkdir()
    for old in before[:-1]:
        shutil.rmtree(old, ignore_errors=True)
    return folder
