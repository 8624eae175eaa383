from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from capture_files import dichasus

from chachart.node.commands.main import main
from chachart.node.data.csi import CsiBlock
from chachart.node.files.recording import RecordingReader

CSI = 3e-6 * np.random.default_rng(1).standard_normal((100, 4, 8, 2)).view(np.complex128)[..., 0]
POSITION = np.random.default_rng(2).uniform(0, 100, (100, 3))
BASE = ["--csi", "H", "--carrier-hz", "2e9", "--subcarrier-spacing-hz", "15e3"]

Run = Callable[..., tuple[int, str]]


@pytest.fixture
def run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Import variables, given by name, with some options; exit status and what was said."""

    def run(*options: str, **variables: np.ndarray) -> tuple[int, str]:
        source = tmp_path / "in.npz"
        np.savez(source, **(variables or {"H": CSI, "xyz": POSITION}))
        status = main(["import", str(source), str(tmp_path / "out.mcap"), *BASE, *options])
        said = capsys.readouterr()
        return status, said.out + said.err

    return run


def read(tmp_path: Path) -> CsiBlock:
    return CsiBlock.concatenate(list(RecordingReader(tmp_path / "out.mcap").blocks()))


def test_a_capture_becomes_a_recording_of_the_same_frames(run: Run, tmp_path: Path) -> None:
    options = ["--position", "xyz", "--array-position", "1,2,3", "--array-axis=-x", "--height-m", "2"]
    status, said = run(*options, "--array-name", "roof", "--element-spacing-m", "0.05", "--rate", "50")
    assert (status, "100 frames of 100 UEs, 4 antennas x 8 subcarriers" in said) == (0, True)
    array = RecordingReader(tmp_path / "out.mcap").array
    assert (array.name, array.position_m, array.axis) == ("roof", (1.0, 2.0, 3.0), (-1.0, 0.0, 0.0))
    assert (array.element_spacing_m, array.height_m, array.carrier_hz) == (0.05, 2.0, 2e9)
    block = read(tmp_path)
    np.testing.assert_array_equal(block.csi, CSI.astype(np.complex64))
    np.testing.assert_array_equal(block.position, POSITION.astype(np.float32))
    np.testing.assert_array_equal(block.ue, np.arange(100))
    np.testing.assert_array_equal(block.time_ns, np.arange(100) * 20_000_000)


def test_repeats_are_interleaved_and_as_noisy_as_asked(run: Run, tmp_path: Path) -> None:
    status, _ = run("--repeat", "20", "--snr-db", "3", "--seed", "5")
    block = read(tmp_path)
    assert (status, len(block)) == (0, 2000)
    np.testing.assert_array_equal(block.ue, np.tile(np.arange(100), 20))
    clean = np.tile(CSI / np.sqrt(np.mean(np.abs(CSI) ** 2)), (20, 1, 1))
    noise = block.csi - clean
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(10**-0.3, rel=0.02)
    assert abs(np.mean(noise**2)) < 0.01, "circular"
    assert np.abs(noise[:100] - noise[100:200]).min() > 0, "fresh noise each time"


def test_the_same_seed_gives_the_same_noise(run: Run, tmp_path: Path) -> None:
    written = []
    for seed in ("1", "1", "2"):
        assert run("--snr-db", "0", "--seed", seed, "--force")[0] == 0
        written.append(read(tmp_path).csi)
    assert (written[0] == written[1]).all()
    assert (written[0] != written[2]).any()


def test_who_and_when_from_variables(run: Run, tmp_path: Path) -> None:
    ue = np.repeat([7, 9], 50)
    time = np.linspace(2.0, 1.0, 100)
    assert run("--ue", "who", "--time", "t", H=CSI, who=ue, t=time)[0] == 0
    block = read(tmp_path)
    np.testing.assert_array_equal(block.ue, ue[::-1])
    assert (block.time_ns[0], block.time_ns[-1]) == (1_000_000_000, 2_000_000_000)
    assert run("--ue", "who", "--force", H=CSI, who=ue)[0] == 0
    np.testing.assert_array_equal(read(tmp_path).ue, np.tile([7, 9], 50))


def bad_frame(value: complex, frame: int) -> np.ndarray:
    csi = CSI.copy()
    csi[frame] = value
    return csi


@pytest.mark.parametrize(
    ("options", "variables", "words"),
    [
        (["--csi", "h"], {"H": CSI}, ['no variable "h"', "H: complex128 (100, 4, 8)"]),
        (["--position", "p"], {"H": CSI}, ['no variable "p"']),
        (["--position", "H"], {"H": CSI}, ["--position H: must be numbers of shape (100, 3)"]),
        (["--axes", "ue,antenna"], {"H": CSI}, ["--csi H: 3 axes", "H: complex128 (100, 4, 8)"]),
        (["--axes", "ue,antena,subcarrier"], {"H": CSI}, ['there is no "antena"']),
        ([], {"H": CSI.real}, ["complex values are needed"]),
        (["--strict"], {"H": bad_frame(0, 3)}, ['frame 3 of "H" is all zero', "--strict"]),
        (["--strict"], {"H": bad_frame(1 + 1j, 99)}, ['frame 99 of "H" is constant']),
        (["--strict"], {"H": bad_frame(np.nan, 0)}, ['frame 0 of "H" is not finite']),
        (["--strict"], {"H": CSI[:2] * 0}, ['frame 0 of "H" is all zero, as are 1 others']),
        ([], {"H": CSI * 0}, ["every frame"]),
        (["--take", "rx=1"], {"H": CSI}, ['no axis "rx"']),
        (["--axes", "rx,antenna,subcarrier"], {"H": CSI}, ["--take rx=0"]),
        (["--csi", "H,H"], {"H": CSI}, ["is complex128"]),
        (["--tones", "1:3"], {"H": CSI}, ["are 3 numbers for 8 subcarriers"]),
        (["--ue", "7", "--ue-mac", "02:00:00:00:00:01"], {"H": CSI}, ["exclude each other"]),
        (["--position", "1,2,3", "--position", "1,2,4"], {"H": CSI}, ["given 2 times for 1 files"]),
        (["--power", "rssi"], {"H": CSI}, ["--power rssi"]),
        (["--ue", "t"], {"H": CSI, "t": CSI[:, 0, 0].real}, ["--ue t: must be whole numbers"]),
        (["--time", "t"], {"H": CSI, "t": np.zeros(3)}, ["--time t: must have one value for each of 100"]),
        (["--time", "t", "--repeat", "2"], {"H": CSI, "t": np.zeros(100)}, ["exclude each other"]),
        (["--carrier-hz", "-1"], {"H": CSI}, ["--carrier-hz -1.0: must be a number > 0"]),
        (["--array-axis", "q"], {"H": CSI}, ["--array-axis q: must be", '"-z"']),
        (["--array-axis", "y", "--array-broadside", "y"], {"H": CSI}, ["must be orthogonal"]),
        (["--array-name", "a b"], {"H": CSI}, ["--array-name a b: must be text"]),
        (["--rate", "0"], {"H": CSI}, ["--rate 0: must be a number > 0"]),
        (["--snr-db", "nan"], {"H": CSI}, ["--snr-db nan: must be a number"]),
    ],
)
def test_what_does_not_fit_is_told_and_nothing_is_left_behind(
    run: Run, tmp_path: Path, options: list[str], variables: dict[str, np.ndarray], words: list[str]
) -> None:
    status, said = run(*options, **variables)
    assert status == 78
    for word in words:
        assert word in said
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.npz"]


def test_bad_frames_can_be_left_out(run: Run, tmp_path: Path) -> None:
    status, said = run(H=bad_frame(0, 3))
    assert (status, "99 of 100 frames" in said, "1 (all zero)" in said) == (0, True, True)
    assert 3 not in read(tmp_path).ue
    assert RecordingReader(tmp_path / "out.mcap").note["left_out"] == {"all zero": 1}
    assert run("--skip-bad", "--force", H=bad_frame(0, 3))[0] == 0, "as it was called once"


def test_a_recording_is_only_replaced_when_asked(run: Run, tmp_path: Path) -> None:
    (tmp_path / "out.mcap").write_text("precious")
    status, said = run()
    assert (status, "out.mcap exists already; --force" in said) == (78, True)
    assert run("--csi", "wrong", "--force")[0] == 78
    assert (tmp_path / "out.mcap").read_text() == "precious"
    assert run("--force")[0] == 0
    assert len(read(tmp_path)) == 100


def test_one_subcarrier_needs_no_spacing(tmp_path: Path) -> None:
    np.savez(tmp_path / "in.npz", H=CSI[:, :, 0])
    arguments = ["import", str(tmp_path / "in.npz"), str(tmp_path / "out.mcap"), "--csi", "H"]
    assert main([*arguments, "--carrier-hz", "2e9", "--axes", "ue,antenna"]) == 0
    assert read(tmp_path).csi.shape == (100, 4, 1)


def test_several_subcarriers_need_their_spacing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "in.npz", H=CSI)
    arguments = ["import", str(tmp_path / "in.npz"), str(tmp_path / "out.mcap"), "--csi", "H"]
    assert main([*arguments, "--carrier-hz", "2e9"]) == 78
    assert "--subcarrier-spacing-hz is needed" in capsys.readouterr().err


def test_a_folder_that_does_not_exist(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", "in.npz", str(tmp_path / "no" / "out.mcap"), *BASE]) == 78
    assert "there is no such folder" in capsys.readouterr().err


def test_some_frames_and_subcarriers_of_a_flat_array(tmp_path: Path) -> None:
    np.save(tmp_path / "in.npy", CSI.ravel())
    arguments = ["import", str(tmp_path / "in.npy"), str(tmp_path / "out.mcap"), "--csi", "array"]
    arguments += ["--shape", "100,4,8", "--frames", "10:50:4", "--subcarriers", "1::3"]
    assert main([*arguments, "--carrier-hz", "2e9", "--subcarrier-spacing-hz", "15e3"]) == 0
    block = read(tmp_path)
    np.testing.assert_array_equal(block.csi, CSI[10:50:4, :, 1::3].astype(np.complex64))
    np.testing.assert_array_equal(block.ue, np.arange(10, 50, 4))
    array = RecordingReader(tmp_path / "out.mcap").array
    assert (array.carrier_hz, array.subcarrier_spacing_hz, array.subcarriers) == (2e9 + 15e3, 45e3, 3)


def test_frames_are_numbered_as_in_the_file(run: Run) -> None:
    status, said = run("--strict", "--frames", "90:100:3", H=bad_frame(0, 96))
    assert (status, 'frame 96 of "H" is all zero' in said) == (78, True)
    status, said = run("--frames", "200:", H=CSI)
    assert (status, "nothing is left of shape (100, 4, 8)" in said) == (78, True)


@pytest.mark.parametrize(
    "option",
    ["--frames=5", "--frames=a:b", "--frames=0:9:0", "--subcarriers=-3:", "--shape=0,4", "--repeat=0"],
)
def test_options_that_are_no_ranges(run: Run, option: str) -> None:
    with pytest.raises(SystemExit, match="2"):
        run(option)


def test_a_dichasus_file_from_end_to_end(tmp_path: Path) -> None:
    (tmp_path / "in.dat").write_bytes(dichasus(CSI.astype(np.complex64), POSITION))
    arguments = ["import", str(tmp_path / "in.dat"), str(tmp_path / "out.mcap"), "--csi", "csi"]
    arguments += ["--position", "pos-tachy", "--time", "time", "--axes", "ue,antenna,subcarrier,iq"]
    assert main([*arguments, "--carrier-hz", "1.272e9", "--subcarrier-spacing-hz", "48828.125"]) == 0
    block = read(tmp_path)
    np.testing.assert_array_equal(block.csi, CSI.astype(np.complex64))
    np.testing.assert_array_equal(block.position, POSITION.astype(np.float32))
    np.testing.assert_array_equal(block.time_ns, np.arange(100) * 500_000_000)


def test_the_capture_is_never_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "in.npz"
    np.savez(source, H=CSI)
    before = source.read_bytes()
    assert (
        main(["import", str(source), str(source), *BASE, "--axes", "ue,antenna,subcarrier", "--force"]) == 78
    )
    assert "is the file that is read" in capsys.readouterr().err
    assert source.read_bytes() == before


def test_real_and_imaginary_part_in_two_variables_and_the_conjugate(run: Run, tmp_path: Path) -> None:
    assert run("--csi", "re,im", re=CSI.real, im=CSI.imag)[0] == 0
    np.testing.assert_array_equal(read(tmp_path).csi, CSI.astype(np.complex64))
    assert run("--conjugate", "--force", H=CSI)[0] == 0
    np.testing.assert_array_equal(read(tmp_path).csi, CSI.conj().astype(np.complex64))


def test_subcarriers_in_the_order_of_the_fft(run: Run, tmp_path: Path) -> None:
    assert run("--fftshift", H=CSI)[0] == 0
    np.testing.assert_array_equal(read(tmp_path).csi, np.fft.fftshift(CSI, axes=2).astype(np.complex64))
    assert RecordingReader(tmp_path / "out.mcap").array.tones == tuple(range(-4, 4))


def test_numbers_of_the_subcarriers(run: Run, tmp_path: Path) -> None:
    assert run("--tones=-4:-1,1:4", H=CSI)[0] == 0
    assert RecordingReader(tmp_path / "out.mcap").array.tones == (-4, -3, -2, -1, 1, 2, 3, 4)
    assert run("--tones=-4:-1,1:4", "--subcarriers", "2:6", "--force", H=CSI)[0] == 0
    array = RecordingReader(tmp_path / "out.mcap").array
    assert (array.tones, array.carrier_hz) == ((-2, -1, 1, 2), 2e9)


def test_axes_of_other_simulators_are_cut_by_name(run: Run, tmp_path: Path) -> None:
    six = np.random.default_rng(5).standard_normal((2, 4, 3, 1, 5, 8, 2)).view(np.complex128)[..., 0]
    axes = "rx,antenna,ue,tx,frame,subcarrier"
    assert run("--axes", axes, "--take", "rx=1", H=six)[0] == 0
    block = read(tmp_path)
    expected = six[1, :, :, 0].transpose(1, 2, 0, 3).reshape(15, 4, 8).astype(np.complex64)
    assert np.bincount(block.ue.astype(int)).tolist() == [5, 5, 5]
    for ue in range(3):
        np.testing.assert_array_equal(block.csi[block.ue == ue], expected[5 * ue : 5 * ue + 5])


def test_a_clock_in_other_units_that_wraps(run: Run, tmp_path: Path) -> None:
    clock = (2**32 - 5000 + 100 * np.arange(100)).astype(np.uint32)
    assert run("--time", "t", "--time-unit", "us", H=CSI, t=clock)[0] == 0
    np.testing.assert_array_equal(np.diff(read(tmp_path).time_ns), 100_000)
    ticks = np.arange(100) / 4
    assert run("--time", "t", "--time-unit", "ms", "--force", H=CSI, t=ticks)[0] == 0
    np.testing.assert_array_equal(np.diff(read(tmp_path).time_ns), 250_000)


def test_one_transmitter_in_several_files(tmp_path: Path) -> None:
    for n in range(3):
        np.savez(tmp_path / f"pos{n}.npz", H=CSI[20 * n : 20 * n + 20])
    (tmp_path / "places.csv").write_text("file,x,y\npos0,1,2\npos1.npz,3,4\npos2.npz,5,6,1.5\n")
    files = [str(tmp_path / f"pos{n}.npz") for n in range(3)]
    options = ["--ue", "7", "--position-from", str(tmp_path / "places.csv"), "--height-m", "8"]
    assert main(["import", *files, str(tmp_path / "out.mcap"), *BASE, *options]) == 0
    block = read(tmp_path)
    assert set(block.ue.tolist()) == {7}
    places = np.repeat([[1, 2, 2], [3, 4, 2], [5, 6, 1.5]], 20, axis=0)
    assert sorted(map(tuple, block.position.tolist())) == sorted(map(tuple, places.tolist()))


def test_packed_files_are_unpacked(tmp_path: Path) -> None:
    np.save(tmp_path / "in.npy", CSI)
    for name, pack in (("in.npy.gz", gzip.compress), ("in.npy.bz2", bz2.compress)):
        (tmp_path / name).write_bytes(pack((tmp_path / "in.npy").read_bytes()))
        arguments = ["import", str(tmp_path / name), str(tmp_path / "out.mcap"), "--force"]
        assert main([*arguments, "--csi", "array", *BASE[2:]]) == 0
        np.testing.assert_array_equal(read(tmp_path).csi, CSI.astype(np.complex64))


def test_a_packed_file_that_claims_too_much(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in.gz").write_bytes(gzip.compress(bytes(80 << 20)))
    assert main(["import", str(tmp_path / "in.gz"), str(tmp_path / "out.mcap"), *BASE]) == 78
    assert "unpacks to more than" in capsys.readouterr().err


def test_positions_in_degrees(run: Run, tmp_path: Path) -> None:
    degrees = np.column_stack([48.78 + 1e-4 * np.arange(100), np.full(100, 9.18), np.full(100, 1.5)])
    status, said = run("--position", "p", "--position-unit", "deg", H=CSI, p=degrees)
    assert (status, "--origin" in said) == (78, True)
    assert (
        run("--position", "p", "--position-unit", "deg", "--origin", "48.78,9.18", H=CSI, p=degrees)[0] == 0
    )
    position = read(tmp_path).position
    assert position is not None
    np.testing.assert_allclose(position[:, 0], 0, atol=1e-3)
    np.testing.assert_allclose(np.diff(position[:, 1]), 11.12, atol=0.01)
    assert (position[:, 2] == 1.5).all()
