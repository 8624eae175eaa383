from __future__ import annotations

import json
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.geometry import ArrayGeometry
from chachart.sinks.view.frames import describe, encode_frame

ARRAY = ArrayGeometry("lab", 8, 4, 2e9, 312_500.0, 0.075, position_m=(1.0, 2.0, 10.0))
FLOATS = ("theta", "rho", "theta_std", "rho_std", "x", "y", "snr", "snapshots")
KINDS = {"u8": "<u8", "i8": "<i8", "f4": "<f4"}


def update(rows: int, *, known: bool = True) -> ChartUpdate:
    rng = np.random.default_rng(rows)
    floats = {
        name: rng.normal(size=rows)
        for name in ("theta", "rho", "theta_std", "rho_std", "x", "y", "snr", "snapshots")
    }
    position = rng.normal(size=(rows, 3)).astype(np.float32) if known else None
    ue = rng.integers(0, 2**64, rows, dtype=np.uint64, endpoint=False)
    time_ns = 1_700_000_000_000_000_000 + np.arange(rows)
    return ChartUpdate("lab", Method("music", "bartlett"), ue, time_ns, **floats, position=position)


def read(frame: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """As the page does it."""
    length = int.from_bytes(frame[:4], "little")
    header = json.loads(frame[4 : 4 + length])
    at = -(-(4 + length) // 8) * 8
    columns = {}
    for name, kind in header["columns"]:
        dtype = np.dtype(KINDS[kind])
        assert at % dtype.itemsize == 0, "JavaScript reads aligned columns only"
        columns[name] = np.frombuffer(frame, dtype, header["rows"], at)
        at += dtype.itemsize * header["rows"]
    assert at == len(frame)
    return header, columns


@given(st.integers(0, 50), st.booleans(), st.booleans())
def test_a_frame_holds_the_update(rows: int, full: bool, known: bool) -> None:
    sent = update(rows, known=known)
    header, columns = read(encode_frame(sent, ARRAY, full))
    assert header["type"] == "chart"
    assert header["full"] is full
    assert header["method"] == {"theta": "music", "rho": "bartlett"}
    np.testing.assert_array_equal(columns["ue"], sent.ue)
    np.testing.assert_array_equal(columns["time_ns"], sent.time_ns)
    for name in FLOATS:
        np.testing.assert_array_equal(columns[name], getattr(sent, name).astype(np.float32))


def test_truth_is_in_chart_coordinates() -> None:
    sent = update(5)
    assert sent.position is not None
    _, columns = read(encode_frame(sent, ARRAY, full=False))
    np.testing.assert_allclose(columns["true_x"], sent.position[:, 0] - ARRAY.centre_m[0], rtol=1e-5)
    np.testing.assert_allclose(columns["true_y"], sent.position[:, 1] - ARRAY.centre_m[1], rtol=1e-5)


def test_an_unknown_truth_is_not_there() -> None:
    _, columns = read(encode_frame(update(3, known=False), ARRAY, full=True))
    assert not {"true_x", "true_y", "position_x"} & set(columns)


def test_the_page_is_told_of_every_column_that_may_come() -> None:
    _, columns = read(encode_frame(update(3), ARRAY, full=True))
    told = {column["name"]: column["file_name"] for column in describe()}
    assert set(columns) <= set(told)
    assert (told["theta"], told["time_ns"], told["true_x"]) == ("theta_rad", "time_ns", "true_x_m")
