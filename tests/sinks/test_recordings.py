from __future__ import annotations

from pathlib import Path

import pytest
from chart_logs import near_truth, write_chart_log, write_recording

from chachart.node.data.errors import RequestError
from chachart.sinks.recordings import Recordings


def test_what_is_in_the_folder_is_listed_and_can_be_had(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.mcap", ues=6, frames=12)
    write_chart_log(tmp_path / "log.mcap", near_truth(3))
    (tmp_path / "broken.mcap").write_bytes(b"no")
    cut = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(cut[: len(cut) - 60])
    recordings = Recordings(tmp_path)
    found = {one["name"]: one for one in recordings.list()["recordings"]}
    assert set(found) == {"a.mcap", "cut.mcap"}
    whole = found["a.mcap"]
    assert (whole["frames"], whole["ues"], whole["closed"], whole["array"]) == (12, 6, True, "lab")
    assert whole["size"] == path.stat().st_size
    assert found["cut.mcap"]["frames"] is None
    assert recordings.list()["free_bytes"] > 0
    assert recordings.content("a.mcap") == cut


@pytest.mark.parametrize("name", ["../a.mcap", "/etc/passwd", "b.mcap", "", "a.txt"])
def test_nothing_else_can_be_had(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.txt").write_text("secret")
    with pytest.raises(RequestError, match="there is no recording"):
        Recordings(tmp_path).content(name)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="cannot be read"):
        Recordings(tmp_path / "nowhere").list()
