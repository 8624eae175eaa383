"""HDF5, and MATLAB v7.3, which is HDF5 inside, through h5py.

Variables are datasets by their path, as in `measurement/csi`. Complex numbers are pairs named real and imag
(or real and imaginary, r and i, re and im). MATLAB writes arrays with the axes turned around; here they have
MATLAB's order again. A file of cells or structs with CSI is a Wi-Fi capture, as in version 5.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats import matlab73
from chachart.sources.formats.base import Capture, Variable
from chachart.sources.formats.wifi.capture import WifiCapture

if TYPE_CHECKING:
    import h5py

NAME = "HDF5 or MATLAB v7.3 .mat"

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_OFFSETS = (0, 512, 1024, 2048)
_MATLAB = b"MATLAB 7.3 MAT-file"
_PAIRS = ({"real", "imag"}, {"real", "imaginary"}, {"r", "i"}, {"re", "im"})
_DAMAGE = (OSError, RuntimeError, ValueError, KeyError, TypeError, AttributeError, MemoryError)
_FILTERS = (1, 2, 3, 4, 5, 6, 32000)
"""Those that come with HDF5 and h5py: deflate, shuffle, checksum, szip, n-bit, scale-offset, lzf."""
_DENSEST = 1100
"""Deflate makes nothing smaller than this; a file that claims more is not to be believed."""


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
    h5py = _h5py()
    with path.open("rb") as file:
        matlab = file.read(len(_MATLAB)) == _MATLAB
    try:
        with h5py.File(path, "r") as opened:
            if matlab and matlab73.holds_frames(opened):
                return WifiCapture(path, matlab73.CELLS, matlab73.read_structs)
            variables = {
                name: _describe(dataset, matlab, path.stat().st_size) for name, dataset in _datasets(opened)
            }
    except _DAMAGE as error:
        raise SetupError(f"{path} is damaged or cut short: {error}") from None
    if not variables:
        raise SetupError(f"{path} is an HDF5 file without datasets")
    return Hdf5Capture(path, variables, matlab)


class Hdf5Capture(Capture):
    """An opened HDF5 file."""

    format = NAME

    def __init__(self, path: Path, variables: dict[str, Variable], matlab: bool) -> None:
        super().__init__(path, variables)
        self._matlab = matlab

    def _read(self, name: str) -> NDArray[Any]:
        try:
            with _h5py().File(self.path, "r") as opened:
                array = as_complex(np.asarray(opened[name][()]))
        except _DAMAGE as error:
            raise self.damaged(f'variable "{name}": {error}') from None
        return array.T if self._matlab else array


def _h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise SetupError("HDF5 needs the h5py package: pip install 'chachart[formats]'") from None
    return h5py


def _datasets(group: h5py.Group, prefix: str = "") -> Iterator[tuple[str, h5py.Dataset]]:
    import h5py

    for name in group:
        if group.get(name, getlink=True).__class__ is not h5py.HardLink or name.startswith("#"):
            continue
        item = group[name]
        if isinstance(item, h5py.Dataset):
            yield prefix + name, item
        elif isinstance(item, h5py.Group) and prefix.count("/") < 16:
            yield from _datasets(item, f"{prefix}{name}/")


def check_storage(dataset: h5py.Dataset) -> None:
    """Nothing outside the file is read, and no filter that a plug-in would have to bring is run."""
    if dataset.external or dataset.is_virtual:
        raise SetupError(f"{dataset.file.filename}: {dataset.name} keeps its data in other files")
    plan = dataset.id.get_create_plist()
    for number in range(plan.get_nfilters()):
        kind = plan.get_filter(number)[0]
        if kind not in _FILTERS:
            raise SetupError(f"{dataset.file.filename}: {dataset.name} is packed by filter {kind}")


def _describe(dataset: h5py.Dataset, matlab: bool, size: int) -> Variable:
    check_storage(dataset)
    if dataset.nbytes > _DENSEST * size:
        raise ValueError(f"dataset {dataset.name} claims {dataset.nbytes} bytes in a file of {size}")
    shape = tuple(dataset.shape or ())
    kind = "complex" if _is_complex(dataset.dtype) else str(dataset.dtype)
    return Variable(shape[::-1] if matlab else shape, kind)


def _is_complex(dtype: np.dtype[Any]) -> bool:
    return dtype.names is not None and set(dtype.names) in _PAIRS


def as_complex(array: NDArray[Any]) -> NDArray[Any]:
    """An array of pairs as complex numbers; any other as it is."""
    if not _is_complex(array.dtype):
        return array
    real, imaginary = sorted(array.dtype.names or (), reverse=True)
    whole = np.empty(array.shape, np.complex64 if array[real].dtype.itemsize <= 4 else np.complex128)
    whole.real, whole.imag = array[real], array[imaginary]
    return whole
