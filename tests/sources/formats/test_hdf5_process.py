from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture
from chachart.sources.formats.hdf5_process import Hdf5Process, reader


@pytest.fixture
def file(tmp_path: Path) -> Path:
    with h5py.File(tmp_path / "capture", "w") as opened:
        opened["csi"] = np.arange(24.0).reshape(4, 3, 2)
        opened["empty"] = np.empty((0, 3))
        opened["note"] = ["walked", "twice"]
    return tmp_path / "capture"


def test_a_process_that_dies_is_followed_by_another(file: Path) -> None:
    capture = open_capture(file)
    assert reader.pid is not None
    os.kill(reader.pid, signal.SIGKILL)
    np.testing.assert_array_equal(capture.read("csi"), np.arange(24.0).reshape(4, 3, 2))
    assert capture.read("empty").shape == (0, 3)


def test_what_is_not_of_numbers_is_refused(file: Path) -> None:
    with pytest.raises(SetupError, match='"note" is of object, not of numbers'):
        open_capture(file).read("note")


def test_a_library_that_crashes_over_a_file_is_a_clean_error(file: Path) -> None:
    crashing = Hdf5Process([sys.executable, "-c", "import os; input(); os.abort()"])
    with pytest.raises(SetupError, match="is damaged: the HDF5 library was ended by SIGABRT"):
        crashing.ask("describe", file)
    assert crashing.pid is None
    with pytest.raises(SetupError, match="ended with status 3"):
        Hdf5Process([sys.executable, "-c", "import sys; input(); sys.exit(3)"]).ask("describe", file)


def test_interrupted_half_way_it_begins_anew(file: Path) -> None:
    def late(*_: object) -> None:
        raise KeyboardInterrupt

    silent = Hdf5Process([sys.executable, "-c", "import time; time.sleep(100)"])
    before = signal.signal(signal.SIGALRM, late)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(KeyboardInterrupt):
            silent.ask("describe", file)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert silent.pid is None
