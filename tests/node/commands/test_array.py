from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from csi_samples import some_block

from chachart.config.load import ConfigError, load
from chachart.node.commands.main import main
from chachart.node.data.elements import circle
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingReader, RecordingWriter

LAB = '[array]\ncarrier_hz = 1.272e9\n{}\n[source]\ntype = "simulator"\n'


def described(path: Path, keys: str) -> ArrayGeometry:
    path.write_text(LAB.format(keys))
    array = load(path).array
    assert array is not None
    return array.geometry()


def test_a_board_is_described_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    config = tmp_path / "lab.toml"
    config.write_text(LAB.format('rows = 2\ncolumns = 4\naxis = "x"\nup = "z"'))
    picture = tmp_path / "board.png"
    assert main(["array", str(config), "--plot", str(picture)]) == 0
    said = capsys.readouterr().out
    assert "a board of 2 rows x 4 columns" in said
    assert "normal      (0, -1, 0)" in said
    assert "UEs in front" in said
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_shapes_of_the_configuration(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    assert described(path, "antennas = 6").is_line
    ring = described(path, "antennas = 5\nradius_m = 0.1")
    np.testing.assert_allclose(ring.own_elements, circle(5, 0.1), atol=1e-12)
    places = described(path, 'elements = [[0, 0, 0], [0, 0.1, 0], [0.1, 0, 0.1]]\nsees = "below"')
    assert places.antennas == 3
    assert places.facing == pytest.approx([0, -1, 0])
    (tmp_path / "e.csv").write_text("0,0\n0.1,0\n")
    assert described(path, f'file = "{tmp_path / "e.csv"}"').antennas == 2


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ("rows = 2\ncolumns = 4\nradius_m = 0.1", "cannot both be set"),
        ("rows = 2\ncolumns = 4\nantennas = 9", "antennas = 9, but rows and columns make 8"),
        ('rows = 2\nup = "z"\nbroadside = "x"', "broadside and up cannot both be set"),
        ('rows = 2\nup = "y"', "up .* must be orthogonal to axis"),
        ('file = "none.csv"', "none.csv cannot be read"),
        ("elements = [[0, 0, 0], [0, 0, 0]]", "different places"),
    ],
)
def test_what_does_not_go_together_is_said(tmp_path: Path, keys: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        described(tmp_path / "lab.toml", keys)


def test_a_recording_carries_its_elements(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    array = ArrayGeometry.of_elements("ring", circle(4, 0.05), 3, 2e9, 1e6, clock="lab")
    with RecordingWriter(tmp_path / "ring.mcap", array) as writer:
        writer.write(some_block(antennas=4, subcarriers=3, array="ring"))
    assert RecordingReader(tmp_path / "ring.mcap").array == array
    assert main(["array", str(tmp_path / "ring.mcap"), "--json"]) == 0
    assert ArrayGeometry.from_dict(json.loads(capsys.readouterr().out)) == array


def test_an_array_file_without_carrier(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "e.csv").write_text("0,0\n0.07,0\n0.16,0\n")
    assert main(["array", str(tmp_path / "e.csv")]) == 0
    assert "theta alone" in capsys.readouterr().out
    assert main(["array", str(tmp_path / "none.csv")]) == 78
