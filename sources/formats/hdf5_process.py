"""The process that opens HDF5 files for this one: damage that breaks libhdf5 breaks nothing else.

libhdf5 is C, and mutated files have been seen to corrupt its memory. So files are read elsewhere, by
`python -P -m` this module: a request is a line of JSON; an answer is a line of JSON with the facts and what
the arrays are, then the bytes of the arrays. Nothing that comes from there is executed here.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import json
import math
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError

Facts = dict[str, Any]
COMMAND = (sys.executable, "-P", "-m", "chachart.sources.formats.hdf5_process")


class Hdf5Process:
    """A process that reads HDF5 files; it starts with the first request and goes when this process goes."""

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        self._command = command
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """The number of the process; None while there is none."""
        return None if self._process is None else self._process.pid

    def ask(self, do: str, path: Path, **more: str) -> tuple[Facts, list[NDArray[Any]]]:
        """Have `describe` or `read` of `hdf5_file` done to a file.

        A process that ends over it may suffer from an earlier file, and is followed by a fresh one.

        Raises
        ------
        SetupError
            If h5py is not installed, or the file is damaged, refused or too large for the memory.
        """
        if importlib.util.find_spec("h5py") is None:
            raise SetupError("HDF5 needs the h5py package: pip install 'chachart[formats]'")
        request = json.dumps({"do": do, "path": str(path), **more}).encode() + b"\n"
        with self._lock:
            facts, arrays = self._answered(request, path)
        if "refused" in facts:
            raise SetupError(facts["refused"])
        if "fault" in facts:
            raise RuntimeError(f"{path}: {facts['fault']}")
        return facts, arrays

    def stop(self) -> None:
        """End the process, if there is one."""
        with self._lock:
            self._stop()

    def _answered(self, request: bytes, path: Path) -> tuple[Facts, list[NDArray[Any]]]:
        try:
            if self._process is not None:
                with contextlib.suppress(EOFError, BrokenPipeError):
                    return self._exchange(request)
                self._stop()
            return self._exchange(request)
        except (EOFError, BrokenPipeError):
            raise SetupError(f"{path} is damaged: the HDF5 library {self._end()}") from None
        except MemoryError:
            self._stop()
            raise SetupError(f"{path} needs more memory than there is") from None
        except BaseException:
            self._stop()
            raise

    def _exchange(self, request: bytes) -> tuple[Facts, list[NDArray[Any]]]:
        if self._process is None:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(request)
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line.endswith(b"\n"):
            raise EOFError
        facts = json.loads(line)
        return facts, [_read_array(self._process.stdout, *said) for said in facts.get("arrays", ())]

    def _stop(self) -> int:
        """End the process and return how it ended."""
        process, self._process = self._process, None
        if process is None:
            return 0
        process.kill()
        with contextlib.suppress(BrokenPipeError), process:
            pass
        return process.returncode

    def _end(self) -> str:
        """How the process, which has closed its end, came to it."""
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(10)
        status = self._stop()
        return (
            f"ended with status {status}" if status >= 0 else f"was ended by {signal.Signals(-status).name}"
        )


def _read_array(file: Any, kind: str, shape: Sequence[int]) -> NDArray[Any]:
    array = np.empty(tuple(shape), np.dtype(kind))
    free = array.reshape(-1).view(np.uint8).data if array.nbytes else memoryview(b"")
    while free:
        count = file.readinto(free)
        if not count:
            raise EOFError
        free = free[count:]
    return array


reader = Hdf5Process()
"""The one that all files of this process are read by."""
atexit.register(reader.stop)


def main() -> None:
    """Answer requests until there are no more."""
    from chachart.sources.formats import hdf5_file

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for line in sys.stdin.buffer:
        request = json.loads(line)
        path = Path(request.pop("path"))
        try:
            facts, arrays = getattr(hdf5_file, request.pop("do"))(path, **request)
        except SetupError as error:
            facts, arrays = {"refused": str(error)}, []
        except Exception as error:  # noqa: BLE001 - told to the other process, which raises it
            facts, arrays = {"fault": repr(error)}, []
        _answer(sys.stdout.buffer, facts, arrays)


def _answer(file: BinaryIO, facts: Facts, arrays: Sequence[NDArray[Any]]) -> None:
    kinds = [(array.dtype.str, array.shape) for array in arrays]
    file.write(json.dumps({**facts, "arrays": kinds}).encode() + b"\n")
    for array in arrays:
        if math.prod(array.shape):
            file.write(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    file.flush()


if __name__ == "__main__":
    main()
