from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from chachart.node.commands.main import main
from chachart.node.commands.reproduction.scenario import modelled, scenario_array
from chachart.node.data.csi import CsiBlock
from chachart.node.files.recording import RecordingWriter
from chachart.sources.scenario.channel import channels

UES, FRAMES = 300, 2
QUICK = ["--ues", str(UES), "--frames", str(FRAMES), "--runs", "2", "--snr-db", "10"]


class Page(HTMLParser):
    """What a page loads, its anchors, and its tables as rows of texts."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.tables: list[list[list[str]]] = []
        self._cell = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.loaded += [values[name] for name in ("src", "srcset", "data") if name in values]
        if tag == "a":
            self.links.append(values["href"])
        elif "href" in values:
            self.loaded.append(values["href"])
        assert tag not in ("script", "iframe", "object", "link")
        if "id" in values:
            self.ids.add(values["id"])
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self._cell = True

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self._cell = False

    def handle_data(self, data: str) -> None:
        if self._cell:
            self.tables[-1][-1][-1] += data


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run: one channel, three pairs, few paths."""
    folder = tmp_path_factory.mktemp("reproduce") / "report"
    pairs = "bartlett/bartlett,mvdr/lr,music/music"
    argv = ["reproduce", "--channels", "los", "--pairs", pairs, "--paths", "40", "--out", str(folder)]
    assert main([*argv, *QUICK]) == 0
    return folder


def test_the_report_loads_nothing_and_its_tables_hold_the_numbers(out: Path) -> None:
    html = (out / "report.html").read_text("utf-8")
    page = Page()
    page.feed(html)
    assert page.loaded
    assert all(address.startswith("data:image/png;base64,") for address in page.loaded)
    assert not re.search(r"@import|url\(|http", html)
    assert page.links
    assert {link.removeprefix("#") for link in page.links} <= page.ids
    results = json.loads((out / "results.json").read_text())
    los, ranging, accuracy = page.tables
    for table in page.tables:
        assert len({len(row) for row in table}) == 1
    header, *rows = los
    assert [row[0] for row in rows] == [
        "Bartlett / Bartlett",
        "MVDR / LR",
        "MUSIC / MUSIC",
        "PCA",
        "Sammon",
    ]
    for row, found in zip(rows, results["channels"]["los"]["pairs"], strict=False):
        cells = dict(zip(header, row, strict=True))
        assert cells["TW published"] == f"{found['paper']['tw']:.4f}"
        assert cells["CT here"] == f"{found['ct']:.4f}"
        assert ("▲" in row[3]) == (round(found["tw"], 4) > found["paper"]["tw"])
    assert len(ranging) == 6
    assert [row[0] for row in accuracy] == ["method", "Bartlett", "MVDR", "MUSIC"]


def test_the_results_hold_what_was_asked(out: Path) -> None:
    results = json.loads((out / "results.json").read_text())
    assert results["settings"]["ues"] == UES
    los = results["channels"]["los"]
    assert los["k"] == 15
    assert [(p["theta"], p["rho"]) for p in los["pairs"]] == [
        ("bartlett", "bartlett"),
        ("mvdr", "lr"),
        ("music", "music"),
    ]
    for pair in los["pairs"]:
        assert min(pair["tw"], pair["ct"]) > 0.99
        assert len(pair["tw_of_k"]) == len(pair["ct_of_k"]) == 15
        assert pair["tw_of_k"][-1] == pytest.approx(pair["tw"], abs=1e-6)
        assert len(pair["seconds_of_runs"]) == 2
        assert pair["seconds"] == pytest.approx(np.mean(pair["seconds_of_runs"]))
    assert los["pairs"][0]["paper"] == {"tw": 0.9998, "ct": 0.9998, "seconds": 1.1203}
    assert [e["name"] for e in los["embeddings"]] == ["PCA", "Sammon"]
    assert len(los["ranging"]) == 15
    assert [(a["coordinate"], a["bandwidth_hz"]) for a in results["accuracy"]] == [
        ("theta", 312.5e3),
        ("rho", 312.5e3),
        ("rho", 10e6),
    ]
    for figure in ("summary", "charts-los", "curves-los", "accuracy"):
        assert (out / f"{figure}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"{figure}.pdf").read_bytes().startswith(b"%PDF")
    header, first, *_ = (out / "table-los.csv").read_text().splitlines()
    assert header == "methods,TW published,TW,CT published,CT,s published,s"
    assert first.startswith("Bartlett / Bartlett,0.9998,")
    assert "Bartlett / Bartlett & 0.9998 & " in (out / "table-los.tex").read_text()


def test_recorded_channels_take_the_place_of_the_model(tmp_path: Path) -> None:
    array = scenario_array(10e6)
    scene = modelled("los", array, 100, 1, 0.0, 5)
    csi = channels("los", scene.position, array, 5) * np.float32(7.0)
    recording = tmp_path / "field.mcap"
    with RecordingWriter(recording, array) as writer:
        ue = np.arange(100, dtype=np.uint64)
        writer.write(CsiBlock(array.name, 0, ue, ue.astype(np.int64), csi, scene.position.astype(np.float32)))
    argv = ["reproduce", "--channels", "qnlos", "--pairs", "bartlett/isq", "--paths", "0", *QUICK]
    out = tmp_path / "out"
    assert main([*argv, "--data", f"qnlos={recording}", "--out", str(out)]) == 0
    found = json.loads((out / "results.json").read_text())["channels"]["qnlos"]
    assert found["origin"] == "field.mcap"
    assert found["pairs"][0]["tw"] > 0.99


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["--data", "los=absent.mcap"], "absent.mcap"),
        (["--channels", "los", "--data", "qlos=absent.mcap"], "not among --channels"),
        (["--set", "estimator.loading=-1"], "loading"),
        (["--set", "estimator.theta=music"], "--pairs"),
        (["--set", "workers.count=2"], "[estimator]"),
        (["--ues", "100000"], "at most"),
        (["--frames", "10000000"], "fewer frames"),
    ],
)
def test_mistakes_are_told_in_a_line(
    argv: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reproduce", *QUICK, "--out", str(tmp_path / "out"), *argv]) == 78
    error = capsys.readouterr().err
    assert told in error
    assert "Traceback" not in error


@pytest.mark.parametrize("argv", [["--pairs", "joint/music"], ["--channels", "indoor"], ["--frames", "0"]])
def test_what_does_not_exist_is_a_usage_error(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["reproduce", *argv])
    assert argv[0] in capsys.readouterr().err
