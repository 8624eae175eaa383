"""NumPy `.npz`: a zip archive of `.npy` members. Pickled objects are never read."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture, Variable
from chachart.sources.formats.npy import DAMAGE, read_header

NAME = "NumPy .npz"

_DAMAGE = (*DAMAGE, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, KeyError)


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    if not head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return "it is no zip archive"
    return None


def open_capture(path: Path) -> Capture:
    """The arrays of an archive.

    Raises
    ------
    SetupError
        If the archive is damaged or has no arrays.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
            variables = {m.filename.removesuffix(".npy"): _describe(archive, m) for m in members}
    except _DAMAGE as error:
        raise SetupError(f"{path} is a damaged or cut short zip archive: {error}") from None
    if not variables:
        raise SetupError(f"{path} is a zip archive without NumPy arrays")
    return NpzCapture(path, variables)


class NpzCapture(Capture):
    """An opened `.npz` file."""

    format = NAME

    def _read(self, name: str) -> NDArray[Any]:
        try:
            with zipfile.ZipFile(self.path) as archive, archive.open(f"{name}.npy") as member:
                array: NDArray[Any] = np.lib.format.read_array(cast(BinaryIO, member), allow_pickle=False)
        except _DAMAGE as error:
            raise self.damaged(f'variable "{name}": {error}') from None
        return array


def _describe(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Variable:
    with archive.open(member) as stream:
        try:
            return read_header(cast(BinaryIO, stream), member.file_size)
        except DAMAGE as error:
            raise ValueError(f"{member.filename}: {error}") from None
