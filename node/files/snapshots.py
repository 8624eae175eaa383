"""Snapshots of state: arrays and a few facts in one file that is there whole or not at all.

A file is a zip of `.npy` members, as `numpy.savez` writes them: each has a checksum, and the directory at the
end is missing where the file was cut. That is what notices torn ones where a file system cannot rename.
"""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.files.folders import Folder, FolderError, LocalFolder

_FACTS = "facts.json"
_BROKEN = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    zipfile.BadZipFile,
    NotImplementedError,
    RuntimeError,
    zlib.error,
    struct.error,
)
"""What reading a damaged zip or npy raises."""


class SnapshotError(Exception):
    """A snapshot that is torn, damaged or none at all."""


def write_snapshot(
    path: Path,
    facts: Mapping[str, Any],
    arrays: Iterable[tuple[str, NDArray[Any]]],
    durable: bool,
    wanted: Callable[[], bool] = lambda: True,
) -> None:
    """Write a snapshot in place of what is there.

    Parameters
    ----------
    path
        The file.
    facts
        Plain values, as JSON can hold them.
    arrays
        Names and arrays, taken one at a time.
    durable
        Whether it must outlive the machine, not only the process.
    wanted
        Asked at the very end; where it says no, what was there stays.

    Raises
    ------
    OSError
        If it cannot be written; what was there is untouched.
    """
    LocalFolder(path.parent).write(path.name, partial(pack, facts, arrays), durable, wanted)


def pack(facts: Mapping[str, Any], arrays: Iterable[tuple[str, NDArray[Any]]], file: IO[bytes]) -> None:
    """Write facts and arrays into an open file."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)
        archive.writestr(_FACTS, json.dumps(facts))


def read_snapshot(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The facts and the arrays of a snapshot.

    Raises
    ------
    SnapshotError
        If it is not there, cut or damaged anywhere.
    """
    return unpack(LocalFolder(path.parent), path.name)


def unpack(folder: Folder, name: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """As `read_snapshot`, of a file in any folder.

    Raises
    ------
    SnapshotError
        If it is not there, cut or damaged anywhere.
    FolderError
        If the folder cannot be reached.
    """
    path = f"{folder}/{name}"
    try:
        with folder.open(name) as file, zipfile.ZipFile(file) as archive:
            _check(archive, path, file.seek(0, os.SEEK_END))
            facts = json.loads(archive.read(_FACTS))
            arrays = {}
            for member_name in archive.namelist():
                if member_name != _FACTS:
                    with archive.open(member_name) as member:
                        arrays[member_name.removesuffix(".npy")] = np.lib.format.read_array(
                            member, allow_pickle=False
                        )
                        if member.read(1):
                            raise SnapshotError(f"{path} is damaged: {member_name} is too long")
    except FolderError:
        raise
    except _BROKEN as error:
        raise SnapshotError(f"{path} is damaged: {error}") from None
    if not isinstance(facts, dict):
        raise SnapshotError(f"{path} is damaged: it has no facts")
    return facts, arrays


def read_facts(path: Path) -> dict[str, Any]:
    """Only the facts of a snapshot whose arrays may be damaged.

    Raises
    ------
    SnapshotError
        If they cannot be read.
    """
    return unpack_facts(LocalFolder(path.parent), path.name)


def unpack_facts(folder: Folder, name: str) -> dict[str, Any]:
    """As `read_facts`, of a file in any folder.

    Raises
    ------
    SnapshotError
        If they cannot be read.
    FolderError
        If the folder cannot be reached.
    """
    path = f"{folder}/{name}"
    try:
        with folder.open(name) as file, zipfile.ZipFile(file) as archive:
            facts = json.loads(archive.read(_FACTS))
    except FolderError:
        raise
    except _BROKEN as error:
        raise SnapshotError(f"{path} is damaged: {error}") from None
    if not isinstance(facts, dict):
        raise SnapshotError(f"{path} is damaged: it has no facts")
    return facts


def _check(archive: zipfile.ZipFile, path: str, size: int) -> None:
    """See that no member says it is larger than the file, and that all checksums are right."""
    for member in archive.infolist():
        if member.compress_type != zipfile.ZIP_STORED or member.file_size > size:
            raise SnapshotError(f"{path} is damaged: {member.filename} cannot be so large")
    if (bad := archive.testzip()) is not None:
        raise SnapshotError(f"{path} is damaged: the checksum of {bad} is wrong")
