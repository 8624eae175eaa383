"""The files of `[state] directory`: numbered snapshots of which the newest two are kept.

A run has a folder of its own; `--resume` goes on in the newest. In it are `node-<n>.snapshot`, of the main
process, and `worker-<shard>-of-<count>-<n>.snapshot`.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from typing import Any

from numpy.typing import NDArray

from chachart.node.files.folders import UNFINISHED, Folder
from chachart.node.files.snapshots import SnapshotError, pack, unpack, unpack_facts

log = logging.getLogger(__name__)

KEPT = 2
NODE = "node"
STARTED = "started"
"""An empty file: object stores have no folders without one, and who may not write learns it at once."""
_ENDING = ".snapshot"
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

    def __init__(self, folder: Folder, name: str, durable: bool) -> None:
        self._folder = folder
        self._name = name
        self._durable = durable

    def newest(self) -> Iterator[tuple[str, dict[str, Any], dict[str, NDArray[Any]]]]:
        """Those that can be read, newest first; those that cannot are complained about."""
        for name in reversed(self._names()):
            try:
                yield f"{self._folder}/{name}", *unpack(self._folder, name)
            except SnapshotError as error:
                log.warning("%s; the one before it is taken", error)

    def newest_facts(self) -> dict[str, Any] | None:
        """The facts of the newest one that can be read, or None."""
        for name in reversed(self._names()):
            try:
                return unpack_facts(self._folder, name)
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
    ) -> str:
        """Write the next one, unless it is not `wanted` in the end, and let go of those that are not kept.

        Gives its name.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        names = self._names()
        number = 1 + (int(_number(names[-1])) if names else 0)
        name = f"{self._name}-{number:08d}{_ENDING}"
        self._folder.write(name, partial(pack, facts, arrays), self._durable, wanted)
        for old in names[: 1 - KEPT]:
            with suppress(OSError):
                self._folder.remove(old)
        return name

    def _names(self) -> list[str]:
        mine = re.compile(rf"{re.escape(self._name)}-\d{{8}}{re.escape(_ENDING)}")
        return sorted(name for name in self._folder.files() if mine.fullmatch(name))


def _number(name: str) -> str:
    return name.removesuffix(_ENDING).rpartition("-")[2]


def forget_unfinished(folder: Folder, name: str = "") -> None:
    """Take away the snapshots that are being written, so that none of them gets its name any more."""
    for one in folder.files():
        if one.startswith(name) and one.endswith(_ENDING + UNFINISHED):
            with suppress(OSError):
                folder.remove(one)


def worker_series(folder: Folder, shard: int, count: int, durable: bool) -> Series:
    """The snapshots of one worker."""
    return Series(folder, f"worker-{shard}-of-{count}", durable)


def counts(folder: Folder, shard: int, count: int) -> list[int]:
    """Of how many workers there are snapshots that hold what worker `shard` of `count` needs, newest first.

    Of `count` its own will do, of any other number there must be one of each. They are as old as the oldest
    of them: a number that was left and taken up again has some from before.
    """
    newest: dict[int, dict[int, float]] = {}
    for name, changed in folder.files().items():
        if (match := _SHARD.fullmatch(name)) and (int(match[2]) != count or int(match[1]) == shard):
            shards = newest.setdefault(int(match[2]), {})
            shards[int(match[1])] = max(shards.get(int(match[1]), 0.0), changed)
    whole = [n for n, shards in newest.items() if n == count or len(shards) == n]
    return sorted(whole, key=lambda n: min(newest[n].values()), reverse=True)


def runs(directory: Folder) -> list[Folder]:
    """The folders of all runs, oldest first."""
    return [directory.child(name) for name in sorted(directory.folders()) if _RUN.fullmatch(name)]


def new_run(directory: Folder) -> Folder:
    """A folder for a new run; of those before only the last is kept.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    directory.make()
    before = runs(directory)
    stamp = f"run-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    number, folder = 1, directory.child(stamp)
    while folder.is_there():
        number += 1
        folder = directory.child(f"{stamp}-{number}")
    folder.make()
    folder.write(STARTED, lambda file: None, durable=False)
    for old in before[:-1]:
        old.remove_all()
    return folder
