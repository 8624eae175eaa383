from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import pytest

from chachart.sinks.files import file_name, free_name, write_problems


def test_the_time_goes_into_the_name() -> None:
    now = datetime(2026, 1, 31, 23, 59, 59, tzinfo=UTC)
    assert file_name(Path("a/csi-{time}.mcap"), now) == Path("a/csi-20260131T235959Z.mcap")
    assert file_name(Path("a/csi.mcap"), now) == Path("a/csi.mcap")


def test_a_taken_name_gets_a_number(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        path = free_name(tmp_path / "csi.mcap")
        path.touch()
        names.append(path.name)
    assert names == ["csi.mcap", "csi-2.mcap", "csi-3.mcap"]


@pytest.mark.parametrize(("name", "says"), [("no/a", "folder .*no does not exist"), (".", "is a folder")])
def test_what_cannot_be_written_is_told(tmp_path: Path, name: str, says: str) -> None:
    [problem] = write_problems(tmp_path / name)
    assert re.search(says, problem)
