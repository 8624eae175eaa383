"""What the node itself writes, for damage: recordings, chart logs and snapshots."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks.kernels import noisy_blocks
from chachart.node.data.errors import SetupError
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.files.chart_log import ChartLogReader
from chachart.node.files.recording import RecordingReader, RecordingWriter
from chachart.node.files.snapshots import SnapshotError, read_snapshot, write_snapshot
from chachart.sinks.chart_log import ChartLog, ChartLogSettings

ARRAY = ArraySettings(antennas=4, subcarriers=4, subcarrier_spacing_hz=312_500.0)
CHUNKS = 4


def made(name: str, frames: int, rng: np.random.Generator) -> bytes:
    """A file of one of `NAMES` with so many frames or UEs in each of its `CHUNKS`."""
    with tempfile.TemporaryDirectory(prefix="chachart-own-") as folder:
        path = Path(folder) / "made"
        _MAKERS[name](path, frames, int(rng.integers(2**31)))
        return path.read_bytes()


def read(name: str, path: Path) -> None:
    """Open a file and read everything in it.

    Raises
    ------
    SetupError
        If it is refused.
    """
    _READERS[name](path)


def _make_recording(path: Path, frames: int, seed: int) -> None:
    array = ARRAY.geometry()
    with RecordingWriter(path, array) as writer:
        for chunk in range(CHUNKS):
            for block in noisy_blocks(array, frames, frames, seed=seed + chunk):
                writer.write(block)
            writer.flush()


def _make_chart_log(path: Path, ues: int, seed: int) -> None:
    array = ARRAY.geometry()
    estimator = ChartEstimator(array)
    log = ChartLog(ChartLogSettings(path=path), array)
    log.open(None)
    for chunk in range(CHUNKS):
        for block in noisy_blocks(array, ues, ues, seed=seed + chunk):
            log.on_chart(estimator.update(block))
    log.close()


def _make_snapshot(path: Path, ues: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    arrays = {"ue": np.arange(ues, dtype=np.uint64), "sums": rng.standard_normal((ues, 4, 4))}
    write_snapshot(path, {"seq": seed}, arrays.items(), durable=False)


def _read_recording(path: Path) -> None:
    for block in RecordingReader(path).blocks():
        if not np.isfinite(block.csi.view(np.float32)).all():
            raise ValueError("damage in a chunk came through as frames")


def _read_chart_log(path: Path) -> None:
    reader = ChartLogReader(path)
    reader.chart()
    for _ in reader.quality():
        pass


def _read_snapshot(path: Path) -> None:
    try:
        read_snapshot(path)
    except SnapshotError as error:
        raise SetupError(str(error)) from None


_MAKERS: dict[str, Callable[[Path, int, int], None]] = {
    "recording": _make_recording,
    "chart_log": _make_chart_log,
    "snapshot": _make_snapshot,
}
_READERS: dict[str, Callable[[Path], None]] = {
    "recording": _read_recording,
    "chart_log": _read_chart_log,
    "snapshot": _read_snapshot,
}
NAMES = tuple(_MAKERS)
