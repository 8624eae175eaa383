"""The pages that people read: the README is short, its links lead somewhere, its code runs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from csi_samples import small_array, some_block

from chachart.node import RecordingWriter

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text()
PAGES = sorted([ROOT / "README.md", *(ROOT / ".github").glob("*.md"), *ROOT.glob("[a-z]*/**/*.md")])
PAGES = [page for page in PAGES if "build" not in page.parts]
LIBRARY = re.search(r"## As a library\n+```python\n(.*?)```", README, re.DOTALL)


def test_the_readme_is_two_pages() -> None:
    assert len(README.splitlines()) <= 200


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)#]+)", page.read_text()):
        if not re.match(r"[a-z]+:", link):
            assert (page.parent / link).exists(), link


def test_the_script_in_the_readme_runs_and_is_typed(tmp_path: Path) -> None:
    assert LIBRARY is not None
    script, recording = tmp_path / "script.py", tmp_path / "lab.mcap"
    script.write_text(LIBRARY[1])
    assert set(re.findall(r"^from chachart\.?(\S*) import", LIBRARY[1], re.MULTILINE)) == {"node"}
    with RecordingWriter(recording, small_array(antennas=8, subcarriers=8)) as writer:
        writer.write(some_block(antennas=8, subcarriers=8))
    ran = subprocess.run([sys.executable, script, recording], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"\d+ UEs; UE \d+ is at \(\S+, \S+\) m\n", ran.stdout)
    mypy = [sys.executable, "-m", "mypy", "--strict", "--config-file", ROOT / "pyproject.toml", script]
    checked = subprocess.run(mypy, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert checked.returncode == 0, checked.stdout


def test_a_build_has_a_readme_whose_links_work_anywhere() -> None:
    code = "import setup; print(setup.long_description())"
    text = subprocess.run(
        [sys.executable, "-c", f"import setuptools; setuptools.setup = lambda **k: None; {code}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert not [link for link in re.findall(r"\]\(([^)]+)\)", text) if not link.startswith("https://")]
