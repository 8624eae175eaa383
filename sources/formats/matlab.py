"""MATLAB `.mat` files of version 5 (what `save -v6` and `save -v7` write), through scipy."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.errors import SetupError
from chachart.sources.formats.base import Capture, Variable

NAME = "MATLAB v5 .mat"

_HEADER_BYTES = 128
_DAMAGE = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    OSError,
    EOFError,
    MemoryError,
    zlib.error,
    struct.error,
)


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    if len(head) < _HEADER_BYTES or head[126:128] not in (b"IM", b"MI"):
        return "it has no MATLAB header"
    little = head[126:128] == b"IM"
    major = head[125] if little else head[124]
    return None if major == 1 else f"its MATLAB header says version {major}, not 1"


def open_capture(path: Path) -> Capture:
    """The numeric variables of a file.

    Raises
    ------
    SetupError
        If the file is damaged or has no variables.
    """
    from scipy.io import whosmat

    try:
        variables = {name: Variable(tuple(shape), kind) for name, shape, kind in whosmat(str(path))}
    except _DAMAGE as error:
        raise SetupError(f"{path} is damaged or cut short: {error or type(error).__name__}") from None
    if not variables:
        raise SetupError(f"{path} is a MATLAB file without variables")
    return MatlabCapture(path, variables)


class MatlabCapture(Capture):
    """An opened `.mat` file."""

    format = NAME

    def _read(self, name: str) -> NDArray[Any]:
        from scipy.io import loadmat

        try:
            value = loadmat(str(self.path), variable_names=[name])[name]
        except _DAMAGE as error:
            raise self.damaged(f'variable "{name}": {error or type(error).__name__}') from None
        return np.asarray(value)
