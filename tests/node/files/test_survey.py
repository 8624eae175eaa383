"""Tables of known places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.files.survey import read_survey


def test_places_by_ue_and_time(tmp_path: Path) -> None:
    path = tmp_path / "places.csv"
    path.write_text(
        "time, ue, x, y, z\n1970-01-01T00:00:10,7,1,2,3\n20,7,3,2,1\n\n1970-01-01T01:00:05+01:00,8,4,4,4\n"
    )
    survey = read_survey(path)
    assert survey.ues == [7, 8]
    seconds = np.array([10, 15, 20, 21, 5, 15])
    found = survey.at(np.array([7, 7, 7, 7, 8, 9], np.uint64), seconds * 10**9)
    np.testing.assert_allclose(found[:3], [[1, 2, 3], [2, 2, 2], [3, 2, 1]])
    np.testing.assert_allclose(found[4], [4, 4, 4])
    assert np.isnan(found[[3, 5]]).all()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "the first line must be"),
        ("ue,x,y\n1,2,3\n", "the first line must be"),
        ("ue,x,y,z\n1,2,3\n", "line 2: 3 values for 4 columns"),
        ("ue,x,y,z\n-1,2,3,4\n", "line 2: '-1' is no UE id"),
        ("ue,x,y,z\n1,2,3,four\n", "line 2: z = 'four' is no number"),
        ("ue,x,y,z\n1,2,3,inf\n", "must be finite"),
        ("ue,x,y,z,time\n1,2,3,4,noon\n", "neither ISO 8601 nor seconds"),
        ("ue,x,y,z,time\n1,2,3,4,nan\n", "no time that a frame can have"),
        ("ue,x,y,z\n1,2,3,4\n1,2,3,5\n", "UE 1 has 2 places and no time"),
    ],
)
def test_mistakes_are_told(tmp_path: Path, text: str, why: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(ValueError, match=r"p\.csv") as error:
        read_survey(tmp_path / "p.csv")
    assert why in str(error.value)


@given(st.binary(max_size=200), st.booleans())
def test_any_file_is_a_table_or_told_about(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, headed: bool
) -> None:
    path = tmp_path_factory.mktemp("survey") / "p.csv"
    path.write_bytes((b"ue,x,y,z,time\n" if headed else b"") + data)
    try:
        survey = read_survey(path)
    except ValueError:
        return
    assert len(survey.ues) == len(set(survey.ues))
