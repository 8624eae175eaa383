from __future__ import annotations

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from chachart.sinks.plain import encoded, plain


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


@given(
    st.recursive(
        st.floats() | st.integers() | st.text(), lambda v: st.lists(v) | st.dictionaries(st.text(), v)
    )
)
def test_encoding_says_what_plain_values_are(value: object) -> None:
    assert json.loads(encoded(value)) == plain(value)


def test_arrays_are_encoded_as_lists() -> None:
    values = {"ue": np.array([2**64 - 1], np.uint64), "x": np.array([[1.5, np.nan]]).T, "n": np.int32(3)}
    assert json.loads(encoded(values)) == {"ue": [2**64 - 1], "x": [[1.5], [None]], "n": 3}
