"""The frames of a recording as NumPy, HDF5 and MATLAB files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require

Variables = dict[str, Any]


def _npz(path: Path, variables: Variables) -> None:
    with path.open("wb") as file:
        np.savez(file, **variables)


def _hdf5(path: Path, variables: Variables) -> None:
    require("formats", "HDF5:")
    import h5py

    with h5py.File(path, "w") as file:
        for name, value in variables.items():
            file[name] = value


def _mat(path: Path, variables: Variables) -> None:
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    columns = {"ue", "time_ns"}
    shaped = {name: value[:, None] if name in columns else value for name, value in variables.items()}
    try:
        savemat(str(path), shaped, appendmat=False)
    except (MatWriteError, ValueError, OverflowError) as error:
        raise SetupError(f"too much for a MATLAB v5 file, take .h5 instead ({error})") from None


WRITERS: dict[str, Callable[[Path, Variables], None]] = {
    ".npz": _npz,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".mat": _mat,
}
"""By the ending of the file's name. Each raises SetupError where a package is missing or it is too much."""
