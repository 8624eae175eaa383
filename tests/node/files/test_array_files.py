from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from chachart.node.data.elements import grid
from chachart.node.files.array_files import ArrayFile, read_array_file

SPEC = {
    "antennas": [
        {
            "assignments": [[6, 2, 16, 18], [28, 5, 10, 14]],
            "location": [2.6, 1.1, 1.5],
            "direction": [0.0, -2.0, 0.0],
            "spacing": {"horizontal": 0.118, "vertical": 0.12},
        },
        {
            "assignments": [[0, 1], [2, 3]],
            "location": [0, 0, 3],
            "rightvector": [1, 0, 0],
            "upvector": [0, 1, 0],
        },
    ]
}
BOARD = """
combined-array:
  boards:
    left: {host: 192.168.1.3}
    right: {host: 192.168.1.4}
  array:
    - ["left.0.0", "left.0.1", "right.0.0", "right.0.1"]
    - ["left.1.0", "left.1.1", "right.1.0", "right.1.1"]
"""


def read(path: Path, text: str, array: int | None = None, spacing_m: float | None = None) -> ArrayFile:
    path.write_text(text)
    return read_array_file(path, array, spacing_m)


def test_csv_with_and_without_a_head(tmp_path: Path) -> None:
    for head in ("", "right,up,normal\n", "# metres\n"):
        found = read(tmp_path / "a.csv", head + "0,0,0\n0.1,0,0.2\n\n0,0.1\n")
        np.testing.assert_array_equal(found.elements, [[0, 0, 0], [0.1, 0, 0.2], [0, 0.1, 0]])


def test_a_spec_gives_pose_and_channels(tmp_path: Path) -> None:
    found = read(tmp_path / "spec.json", json.dumps(SPEC), array=0)
    np.testing.assert_allclose(found.elements, grid(2, 4, 0.118, 0.12))
    assert found.channels == (6, 2, 16, 18, 28, 5, 10, 14)
    assert found.position_m == (2.6, 1.1, 1.5)
    assert found.right is not None
    assert found.up is not None
    np.testing.assert_allclose(np.cross(found.right, found.up), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(found.up, [0, 0, 1], atol=1e-12)
    second = read(tmp_path / "spec.json", json.dumps(SPEC), array=1, spacing_m=0.1)
    np.testing.assert_allclose(second.elements, grid(2, 2, 0.1))
    assert (second.right, second.up, second.channels) == ((1, 0, 0), (0, 1, 0), None)


def test_a_combined_array_names_each_antennas_channel(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    found = read(tmp_path / "board.yml", BOARD)
    np.testing.assert_allclose(found.elements, grid(2, 4, 0.06))
    assert found.channels == (0, 1, 8, 9, 4, 5, 12, 13)


@pytest.mark.parametrize(
    ("name", "text", "array", "says"),
    [
        ("a.csv", "", None, "has no elements"),
        ("a.csv", "0,0,0\nx,y,z\n", None, "line 2"),
        ("a.csv", "0,nan,0\n", None, "line 1"),
        ("a.txt", "", None, "only .csv, .json"),
        ("s.json", "{", None, "is not JSON"),
        ("s.json", "[]", None, "no list"),
        ("s.json", json.dumps(SPEC), None, "has 2 arrays: say which"),
        ("s.json", json.dumps(SPEC), 2, "arrays 0 to 1, no 2"),
        ("s.json", json.dumps(SPEC), 1, "set element_spacing_m"),
        ("b.yml", "boards: [a]\narray: [['a.2.0']]", None, "no antenna of the boards"),
        ("b.yml", "[", None, "is not YAML"),
        ("b.yml", "boards: [a]\narray: [['a.0.0', 'a.0.0']]", None, "twice"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, name: str, text: str, array: int | None, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        read(tmp_path / name, text, array)


VALUES = st.recursive(
    st.none() | st.floats() | st.text(max_size=3) | st.integers(-2, 9),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["antennas", "assignments", "location", "direction", "boards", "array"]), inner
        )
    ),
    max_leaves=12,
)


@given(VALUES, st.sampled_from([".json", ".yml"]))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_document_is_an_array_or_a_value_error(tmp_path: Path, value: object, suffix: str) -> None:
    if suffix == ".yml":
        pytest.importorskip("yaml")
    try:
        found = read(tmp_path / f"any{suffix}", json.dumps(value), spacing_m=0.1)
    except ValueError:
        return
    assert found.elements.shape[1] == 3
