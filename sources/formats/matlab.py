"""MATLAB `.mat` files of version 5 (what `save -v6` and `save -v7` write): their numeric arrays.

A file is a header of 128 bytes and elements, each a tag (type and length) and data; a compressed element
holds another one. An array is an element of elements: flags, dimensions, name, real and perhaps imaginary
part. Every length is checked against the bytes there are, which scipy's reader does not do.

A file of cells or structs with CSI, as read_bf_file of the Intel 5300 tool returns them, is a Wi-Fi capture.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture
from chachart.sources.formats.matlab_elements import HEADER_BYTES, Array, array_in, matrices, order_of
from chachart.sources.formats.wifi.bf_file import CELLS, frames_in, read_cells
from chachart.sources.formats.wifi.capture import WifiCapture

NAME = "MATLAB v5 .mat"


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    if len(head) < HEADER_BYTES or head[126:128] not in (b"IM", b"MI"):
        return "it has no MATLAB header"
    major = head[125] if head[126:128] == b"IM" else head[124]
    return None if major == 1 else f"its MATLAB header says version {major}, not 1"


def open_capture(path: Path) -> Capture:
    """The numeric arrays of a file.

    Raises
    ------
    SetupError
        If the file is damaged, cut short, or has none.
    """
    try:
        data = path.read_bytes()
        arrays = {array.name: array for array in _arrays(data)}
        # Labels and the like may stand beside the cells; who has complex arrays means those.
        if not any(len(array.parts) > 1 for array in arrays.values()) and frames_in(data):
            return WifiCapture(path, CELLS, read_cells)
    except (ValueError, OSError) as error:
        raise SetupError(f"{path} is damaged or cut short: {error}") from None
    if not arrays:
        raise SetupError(f"{path} is a MATLAB file without numeric arrays")
    return MatlabCapture(path, arrays)


class MatlabCapture(Capture):
    """An opened `.mat` file."""

    format = NAME

    def __init__(self, path: Path, arrays: dict[str, Array]) -> None:
        super().__init__(path, {name: array.variable() for name, array in arrays.items()})
        self._arrays = arrays

    def _read(self, name: str) -> NDArray[Any]:
        try:
            return self._arrays[name].read()
        except ValueError as error:
            raise self.damaged(error) from None


def _arrays(data: bytes) -> Iterator[Array]:
    order = order_of(data)
    for element in matrices(data):
        if (array := array_in(element, order)) is not None:
            yield array
