"""Turn a recording into a file for other tools: NumPy .npz, HDF5 (.h5, .hdf5) or MATLAB v5 (.mat).

    chachart export capture.mcap capture.mat

It holds csi (frames, antennas, subcarriers), ue, time_ns, position where known, and array, the description of
the array as JSON. Nothing is rounded: `chachart import` makes the same frames of it again, with
--csi csi --ue ue --time time_ns --position position.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from chachart.node.commands.cli import check_writable, written_whole
from chachart.node.csi import CsiBlock
from chachart.node.errors import SetupError
from chachart.node.recording import RecordingReader

Variables = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart export`."""
    parser.add_argument("recording", type=Path, metavar="IN.mcap", help="the recording")
    parser.add_argument("out", type=Path, metavar="OUT", help=f"the file: {', '.join(_WRITERS)}")
    parser.add_argument("--from", dest="from_s", type=float, default=0.0, metavar="S", help="begin so late")
    parser.add_argument("--to", dest="to_s", type=float, metavar="S", help="end after so many seconds")
    parser.add_argument("--force", action="store_true", help="replace OUT if it exists")


def run(arguments: argparse.Namespace) -> int:
    """Export the recording.

    Raises
    ------
    SetupError
        If the recording cannot be read or has no frames in that time, or the file cannot be written.
    """
    write = _WRITERS.get(arguments.out.suffix.lower())
    if write is None:
        raise SetupError(f"{arguments.out} must end in one of {', '.join(_WRITERS)}")
    check_writable(arguments.out, arguments.force)
    reader = RecordingReader(arguments.recording)
    start = reader.start_ns or 0
    end = None if arguments.to_s is None else start + round(arguments.to_s * 1e9)
    blocks = list(reader.blocks(start + round(arguments.from_s * 1e9), end))
    if not blocks:
        raise SetupError(f"{arguments.recording} has no frames in that time")
    block = CsiBlock.concatenate(blocks)
    variables: Variables = {"csi": block.csi, "ue": block.ue, "time_ns": block.time_ns}
    if block.position is not None:
        variables["position"] = block.position
    variables["array"] = json.dumps(reader.array.as_dict())
    with written_whole(arguments.out) as part:
        write(part, variables)
    shape = " x ".join(map(str, block.csi.shape))
    print(f"{arguments.out}: csi {shape}, {', '.join(list(variables)[1:])}")
    return 0


def _npz(path: Path, variables: Variables) -> None:
    with path.open("wb") as file:
        np.savez(file, **variables)


def _hdf5(path: Path, variables: Variables) -> None:
    try:
        import h5py
    except ImportError:
        raise SetupError("HDF5 needs the h5py package: pip install 'chachart[formats]'") from None
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


_WRITERS: dict[str, Callable[[Path, Variables], None]] = {
    ".npz": _npz,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".mat": _mat,
}
