"""What is done to HDF5 files, through h5py, in the process of `hdf5_process`: each gives facts and arrays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats import matlab73
from chachart.sources.formats.base import Variable

if TYPE_CHECKING:
    import h5py

_MATLAB = b"MATLAB 7.3 MAT-file"
_PAIRS = ({"real", "imag"}, {"real", "imaginary"}, {"r", "i"}, {"re", "im"})
_DAMAGE = (OSError, RuntimeError, ValueError, KeyError, TypeError, AttributeError, MemoryError)
_FILTERS = (1, 2, 3, 4, 5, 6, 32000)
"""Those that come with HDF5 and h5py: deflate, shuffle, checksum, szip, n-bit, scale-offset, lzf."""
_DENSEST = 1100
"""Deflate makes nothing smaller than this; a file that claims more is not to be believed."""

Answer = tuple[dict[str, Any], list[NDArray[Any]]]


def describe(path: Path) -> Answer:
    """The variables of a file, or the frames of cells and structs in it: names of fields, and their arrays.

    Raises
    ------
    SetupError
        If it is damaged or has neither.
    """
    import h5py

    try:
        with path.open("rb") as file:
            matlab = file.read(len(_MATLAB)) == _MATLAB
        with h5py.File(path, "r") as opened:
            frames = matlab73.frames(opened) if matlab else []
            if frames:
                return {"frames": [list(frame) for frame in frames]}, [a for f in frames for a in f.values()]
            size = path.stat().st_size
            found = {name: _variable(dataset, matlab, size) for name, dataset in _datasets(opened)}
    except _DAMAGE as error:
        raise SetupError(f"{path} is damaged or cut short: {error}") from None
    if not found:
        raise SetupError(f"{path} is an HDF5 file without datasets")
    return {"variables": {name: (v.shape, v.dtype) for name, v in found.items()}, "matlab": matlab}, []


def read(path: Path, name: str) -> Answer:
    """One variable, its axes as in the file.

    Raises
    ------
    SetupError
        If it is damaged or neither of numbers nor of text of one length.
    """
    import h5py

    try:
        with h5py.File(path, "r") as opened:
            array = as_complex(np.asarray(opened[name][()]))
    except _DAMAGE as error:
        raise SetupError(f'{path} is damaged or cut short: variable "{name}": {error}') from None
    if array.dtype.kind not in "biufcSU":
        raise SetupError(f'{path}: variable "{name}" is of {array.dtype}, not of numbers')
    return {}, [array]


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


def _variable(dataset: h5py.Dataset, matlab: bool, size: int) -> Variable:
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
