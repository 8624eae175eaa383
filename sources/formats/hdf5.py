"""HDF5, and MATLAB v7.3, which is HDF5 inside, through h5py in a process of its own.

Variables are datasets by their path, as in `measurement/csi`. Complex numbers are pairs named real and imag
(or real and imaginary, r and i, re and im). MATLAB writes arrays with the axes turned around; here they have
MATLAB's order again. A file of cells or structs with CSI is a Wi-Fi capture, as in version 5.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from chachart.sources.formats.base import Capture, Variable
from chachart.sources.formats.hdf5_process import reader
from chachart.sources.formats.matlab73 import CELLS
from chachart.sources.formats.wifi.bf_file import log_of
from chachart.sources.formats.wifi.capture import WifiCapture

NAME = "HDF5 or MATLAB v7.3 .mat"

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_OFFSETS = (0, 512, 1024, 2048)


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    found = any(head[at : at + len(_SIGNATURE)] == _SIGNATURE for at in _OFFSETS)
    return None if found else "it has no HDF5 signature"


def open_capture(path: Path) -> Capture:
    """The datasets of a file.

    Raises
    ------
    SetupError
        If h5py is not installed, or the file is damaged or has no datasets.
    """
    facts, arrays = reader.ask("describe", path)
    if "frames" in facts:
        values = iter(arrays)
        frames = [dict(zip(names, values, strict=False)) for names in facts["frames"]]
        return WifiCapture(path, CELLS, lambda _: log_of(frames))
    variables = {name: Variable(tuple(shape), kind) for name, (shape, kind) in facts["variables"].items()}
    return Hdf5Capture(path, variables, facts["matlab"])


class Hdf5Capture(Capture):
    """An opened HDF5 file."""

    format = NAME

    def __init__(self, path: Path, variables: dict[str, Variable], matlab: bool) -> None:
        super().__init__(path, variables)
        self._matlab = matlab

    def _read(self, name: str) -> NDArray[Any]:
        _, [array] = reader.ask("read", self.path, name=name)
        return array.T if self._matlab else array
