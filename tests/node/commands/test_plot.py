from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from chart_logs import near_truth, write_chart_log, write_recording
from PIL import Image

from chachart.node.commands.main import main
from chachart.node.data.calibration import Calibration
from chachart.node.files.calibration import save_calibration

COLUMN_PIXELS = 1050


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one file of each kind."""
    folder = tmp_path_factory.mktemp("plot")
    write_recording(folder / "los.mcap")
    write_chart_log(folder / "log.mcap", near_truth(50), near_truth(20, seed=1), reports=5)
    write_chart_log(folder / "log-2.mcap", near_truth(50, seed=2), reports=2)
    write_chart_log(folder / "blind.mcap", near_truth(50, position=False))
    write_chart_log(folder / "empty.mcap")
    lines = [{"time_ns": n * 10**12, "array": "lab", "tw": 0.99, "ct": 0.98, "k": 5} for n in range(9)]
    (folder / "quality.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (folder / "text.txt").write_text("nothing of use\n")
    rng = np.random.default_rng(0)
    phases = tuple(rng.uniform(-4, 4, 8).tolist())
    order = (1, 0, *range(2, 8))
    calibration = Calibration(order, tuple(rng.uniform(0.5, 2, 8).tolist()), phases, (1.0,) * 8, (0.0,) * 8)
    save_calibration(folder / "cal.toml", calibration, "made up")
    return folder


FIGURES = {
    "chart of a recording": ["chart", "los.mcap", "--theta", "music", "--rho", "lr"],
    "chart of a log": ["chart", "log.mcap", "log-2.mcap"],
    "chart without truth": ["chart", "blind.mcap"],
    "spectra": ["spectra", "los.mcap", "--ue", "7"],
    "spectra, amplitude": ["spectra", "los.mcap", "--ue", "7", "--theta", "mvdr", "--rho", "isq"],
    "spectra, joint": ["spectra", "los.mcap", "--ue", "7", "--rho", "joint"],
    "quality of a recording": ["quality", "los.mcap"],
    "quality of a log": ["quality", "log.mcap", "log-2.mcap"],
    "quality log": ["quality", "quality.jsonl"],
    "errors": ["errors", "log.mcap"],
    "calibration": ["calibration", "cal.toml"],
}


@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_as_wide_as_a_column(
    files: Path,
    tmp_path: Path,
    name: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(files)
    out = tmp_path / "figure.png"
    assert main(["plot", *FIGURES[name], "-o", str(out)]) == 0, capsys.readouterr().err
    with Image.open(out) as image:
        assert image.width == COLUMN_PIXELS
        assert np.unique(np.asarray(image.convert("L"))).size > 20
    assert list(tmp_path.iterdir()) == [out]


def svg(files: Path, out: Path, *argv: str) -> str:
    assert main(["plot", argv[0], str(files / argv[1]), *argv[2:], "-o", str(out)]) == 0
    return out.read_text("utf-8")


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("chart", "log.mcap"), ["x along broadside (m)", "y along the array (m)", "channel chart"]),
        (("errors", "log.mcap"), ["position error (m)", "true x along broadside (m)", "median"]),
        (("quality", "log.mcap"), ["neighbours K of 50 UEs", "time since the first report (s)", "TW", "CT"]),
        (("quality", "quality.jsonl"), ["time since the first report (h)", "TW, CT at K = 5"]),
        (("spectra", "los.mcap", "--ue", "7"), ["ρ (m)", "spectrum (dB)", "truth", "estimate", "±"]),
        (
            ("calibration", "cal.toml"),
            ["phase (°)", "gain (dB)", "element of the array", "on another's input"],
        ),
    ],
)
def test_axes_have_units_and_letters_are_legible(
    files: Path, tmp_path: Path, argv: tuple[str, ...], words: list[str]
) -> None:
    drawn = svg(files, tmp_path / "figure.svg", *argv)
    for word in words:
        assert word in drawn
    sizes = [float(size) for size in re.findall(r"font-size: ([\d.]+)px", drawn)]
    assert min(sizes) >= 7  # an SVG of matplotlib has 72 pixels an inch


@pytest.mark.parametrize(("ending", "start"), [("PDF", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_the_same_chart_gives_the_same_file(files: Path, tmp_path: Path, ending: str, start: bytes) -> None:
    outs = [tmp_path / f"{name}.{ending}" for name in "ab"]
    for out in outs:
        assert main(["plot", "quality", str(files / "log.mcap"), "-o", str(out)]) == 0
    first, second = (out.read_bytes() for out in outs)
    assert first.startswith(start)
    assert first == second


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["chart", "los.mcap", "-o", "a.gif"], "a.gif must end in one of .png, .svg, .pdf"),
        (["chart", "los.mcap", "-o", "no/a.png"], "there is no such folder"),
        (["chart", "nothing.mcap", "-o", "a.png"], "nothing.mcap"),
        (["chart", "text.txt", "-o", "a.png"], "text.txt is not an MCAP file"),
        (["chart", "empty.mcap", "-o", "a.png"], "empty.mcap has no chart in it"),
        (["chart", "los.mcap", "los.mcap", "-o", "a.png"], "one recording at a time"),
        (["chart", "log.mcap", "los.mcap", "-o", "a.png"], "los.mcap is no chart log"),
        (["errors", "blind.mcap", "-o", "a.png"], "0 UEs have a known position"),
        (["quality", "blind.mcap", "-o", "a.png"], "0 UEs have a known position"),
        (["quality", "text.txt", "-o", "a.png"], "text.txt is not an MCAP file"),
        (["quality", "nothing.jsonl", "-o", "a.png"], "cannot read nothing.jsonl"),
        (["spectra", "log.mcap", "--ue", "7", "-o", "a.png"], "they need a recording"),
        (["spectra", "los.mcap", "--ue", "999", "-o", "a.png"], "no frames of UE 999; it has 60 UEs: 0, 1"),
        (["calibration", "text.txt", "-o", "a.png"], "text.txt is no calibration"),
        (["calibration", "los.mcap", "-o", "a.png"], "los.mcap holds no calibration"),
    ],
)
def test_mistakes_are_one_line(
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    argv: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(files)
    before = sorted(files.iterdir())
    assert main(["plot", *argv]) == 78
    said = capsys.readouterr().err
    assert words in said
    assert len(said.splitlines()) == 1
    assert sorted(files.iterdir()) == before
