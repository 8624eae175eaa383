from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from csi_samples import START_NS, assert_same_frames, small_array, some_block
from scipy.io import loadmat

from chachart.node.commands.main import main
from chachart.node.data.csi import CsiBlock
from chachart.node.files.recording import RecordingReader, RecordingWriter

ENDINGS = [".npz", ".h5", ".hdf5", ".mat"]


def record(path: Path, *, position: bool = True) -> CsiBlock:
    """A recording of 100 frames, 10 ms apart, with extreme UE numbers and unknown positions among them."""
    block = some_block(100, step_ns=10_000_000, position=position)
    ue = block.ue.copy()
    ue[:2] = 0, 2**64 - 1
    block = replace(block, ue=ue)
    if block.position is not None:
        block.position[3] = np.nan
    with RecordingWriter(path, small_array()) as writer:
        writer.write(block)
    return block


def read(path: Path) -> list[CsiBlock]:
    return list(RecordingReader(path).blocks())


@pytest.mark.parametrize("position", [True, False])
@pytest.mark.parametrize("ending", ENDINGS)
def test_there_and_back_again(tmp_path: Path, ending: str, position: bool) -> None:
    block = record(tmp_path / "a.mcap", position=position)
    assert main(["export", str(tmp_path / "a.mcap"), str(tmp_path / f"b{ending}")]) == 0
    back = ["import", str(tmp_path / f"b{ending}"), str(tmp_path / "c.mcap"), "--csi", "csi", "--ue", "ue"]
    back += ["--time", "time_ns", "--carrier-hz", "2e9", "--subcarrier-spacing-hz", "312500"]
    back += ["--element-spacing-m", "0.075", "--array-position", "0,0,0"]
    assert main(back + ["--position", "position"] * position) == 0
    assert_same_frames(read(tmp_path / "c.mcap"), block)
    assert RecordingReader(tmp_path / "c.mcap").array.mismatches(small_array()) == []


def test_what_other_tools_see(tmp_path: Path) -> None:
    block = record(tmp_path / "a.mcap")
    for ending in (".npz", ".h5", ".mat"):
        assert main(["export", str(tmp_path / "a.mcap"), str(tmp_path / f"b{ending}")]) == 0
    npz = dict(np.load(tmp_path / "b.npz"))
    with h5py.File(tmp_path / "b.h5") as file:
        hdf5 = {name: file[name][()] for name in file}
    mat = {name: v for name, v in loadmat(tmp_path / "b.mat").items() if not name.startswith("__")}
    for variables in (npz, hdf5, mat):
        assert set(variables) == {"csi", "ue", "time_ns", "position", "array"}
        np.testing.assert_array_equal(variables["csi"], block.csi)
        np.testing.assert_array_equal(variables["ue"].ravel(), block.ue)
    assert json.loads(str(npz["array"]))["antennas"] == 4
    assert json.loads(hdf5["array"]) == json.loads(mat["array"][0])


def test_a_stretch_of_time(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap")
    argv = ["export", str(tmp_path / "a.mcap"), str(tmp_path / "b.npz"), "--from", "0.2", "--to", "0.5"]
    assert main(argv) == 0
    times = np.load(tmp_path / "b.npz")["time_ns"]
    assert (times[0] - START_NS, len(times)) == (200_000_000, 30)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["a.mcap", "b.xyz"], "must end in one of .npz, .h5, .hdf5, .mat"),
        (["a.mcap", "no/b.npz"], "there is no such folder"),
        (["a.mcap", "a.npz"], "exists already; --force"),
        (["nowhere.mcap", "b.npz"], "nowhere.mcap"),
        (["a.mcap", "b.npz", "--from", "9"], "has no frames in that time"),
    ],
)
def test_what_cannot_be(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    argv: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "a.mcap")
    (tmp_path / "a.npz").touch()
    assert main(["export", *argv]) == 78
    assert words in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "a.npz"]
