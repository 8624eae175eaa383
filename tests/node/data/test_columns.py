from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from chachart.node.data.columns import COLUMNS, Column, markdown, rounded


@given(npst.arrays(np.float64, st.integers(0, 20), elements=st.floats(-1e9, 1e9) | st.just(np.nan)))
def test_columns_are_rounded(column: np.ndarray) -> None:
    expected = [None if np.isnan(v) else round(float(v), 3) for v in column]
    got = rounded(column, 3)
    assert [v is None for v in got] == [v is None for v in expected]
    assert all(abs(a - b) < 1.001e-3 for a, b in zip(got, expected, strict=True) if b is not None)


@pytest.mark.parametrize("column", COLUMNS.values(), ids=list(COLUMNS))
def test_every_column_is_whole(column: Column) -> None:
    """It can be named in a file, filled in, and told to people."""
    flat = dict(column.flat(column.missing(2)))
    assert all(values.shape == (2,) for values in flat.values())
    assert all(column.file_name(name).startswith(name) for name in flat)
    assert column.about.endswith(".")
    assert not column.known(column.missing(2)).any()


def test_angles_are_degrees_for_people() -> None:
    unit, factor, digits = COLUMNS["theta"].for_people()
    assert (unit, round(np.pi * factor), digits) == ("°", 180, 2)
    assert COLUMNS["rho"].for_people() == ("m", 1.0, 2)


def test_the_protocol_has_the_table_of_columns() -> None:
    page = Path(__file__).resolve().parents[3] / "node" / "net" / "PROTOCOL.md"
    table = page.read_text().partition("columns.markdown -->\n")[2].partition("\n<!-- end")[0]
    assert table == markdown()
