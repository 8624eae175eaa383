from __future__ import annotations

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from chachart.sinks.plain import plain, rounded


@given(
    st.recursive(
        st.floats() | st.integers() | st.text(), lambda v: st.lists(v) | st.dictionaries(st.text(), v)
    )
)
def test_anything_becomes_json(value: object) -> None:
    assert plain(json.loads(json.dumps(plain(value), allow_nan=False))) == plain(value)


def test_numpy_becomes_numbers() -> None:
    assert plain({"a": np.float32(0.5), "b": np.array([1.0, np.nan]), "c": (np.int64(3), None)}) == {
        "a": 0.5, "b": [1.0, None], "c": [3, None]
    }  # fmt: skip


@given(npst.arrays(np.float64, st.integers(0, 20), elements=st.floats(-1e9, 1e9) | st.just(np.nan)))
def test_columns_are_rounded(column: np.ndarray) -> None:
    expected = [None if np.isnan(v) else round(float(v), 3) for v in column]
    got = rounded(column, 3)
    assert [v is None for v in got] == [v is None for v in expected]
    assert all(abs(a - b) <= 1e-3 for a, b in zip(got, expected, strict=True) if b is not None)
