from __future__ import annotations

from pathlib import Path

import pytest

from chachart.node.data.errors import SetupError
from chachart.sinks.view.names import load_names, ue_number


def test_names_by_number_and_by_mac_address(tmp_path: Path) -> None:
    path = tmp_path / "names.csv"
    path.write_text('ue,name\n17,forklift\n\n0x1f, drone \n"a4:cf:12:00:00:01","Anna\'s, phone"\n')
    assert load_names(path) == {17: "forklift", 31: "drone", 0xA4CF12000001: "Anna's, phone"}


@pytest.mark.parametrize("text", ["", "x", "-1", "1.5", f"{2**64}", "a4:cf:12:00:00", "a4:cf:12:00:00:0g"])
def test_what_names_no_ue(text: str) -> None:
    assert ue_number(text) is None


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"ue,name\n1,a\nx,b\n", "line 3: 'x' is no UE's number"), (b"1,\xff\n", "is no CSV file")],
)
def test_mistakes_say_where(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "names.csv"
    path.write_bytes(content)
    with pytest.raises(SetupError, match=words):
        load_names(path)
    with pytest.raises(SetupError, match="cannot read"):
        load_names(tmp_path / "none.csv")
