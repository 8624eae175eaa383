"""Protocol 1: what is encoded is decoded, and any bytes are a message or a WireError."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
from chart_samples import some_chart
from csi_samples import assert_same_frames, some_block
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS
from chachart.node.data.csi import CsiBlock
from chachart.node.net.wire import (
    MAX_HEADER_BYTES,
    WireError,
    chart_topic,
    decode_chart,
    decode_csi,
    decode_csi_map,
    decode_report,
    encode_chart,
    encode_csi,
    encode_csi_map,
    encode_report,
)

REASONS = {"parts", "header", "version", "type", "field", "shape", "dtype", "size", "scale"}
names = st.text(min_size=1, max_size=20)
floats = st.floats(width=64)


@st.composite
def csi_blocks(draw: st.DrawFn) -> CsiBlock:
    k, antennas, subcarriers = (draw(st.integers(1, 5)) for _ in range(3))
    shape = (k, antennas, subcarriers)
    position = draw(st.none() | npst.arrays(np.float32, (k, 3)))
    return CsiBlock(
        draw(names),
        draw(st.integers(0, 2**63 - 1)),
        draw(npst.arrays(np.uint64, (k,))),
        draw(npst.arrays(np.int64, (k,))),
        draw(npst.arrays(np.complex64, shape)),
        position,
        draw(st.none() | npst.arrays(np.uint64, (k,))),
    )


@st.composite
def charts(draw: st.DrawFn) -> ChartUpdate:
    k = draw(st.integers(0, 5))
    columns = {
        c.name: draw(npst.arrays(np.float64, c.shape(k), elements=floats))
        for c in COLUMNS.values()
        if c.dtype == "float64"
    }
    return ChartUpdate(
        draw(names),
        Method(draw(names), draw(names)),
        ue=draw(npst.arrays(np.uint64, (k,))),
        time_ns=draw(npst.arrays(np.int64, (k,))),
        position=draw(st.none() | npst.arrays(np.float32, (k, 3))),
        **columns,
    )


plain_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=10,
)


def header_of(block: CsiBlock) -> dict[str, Any]:
    header: dict[str, Any] = msgpack.unpackb(encode_csi(block)[0])
    return header


def reason_of(decode: Callable[..., object], *arguments: object) -> str:
    with pytest.raises(WireError) as caught:
        decode(*arguments)
    assert len(str(caught.value)) < 400
    return caught.value.reason


def outcome(decode: Callable[..., object], *arguments: object) -> object:
    """What `decode` gives, or the reason of its WireError; any other error goes through."""
    try:
        return decode(*arguments)
    except WireError as error:
        return error.reason


def is_a(kind: type, result: object) -> bool:
    return isinstance(result, kind) or result in REASONS


@given(csi_blocks())
def test_csi_round_trip(block: CsiBlock) -> None:
    for decoded in (decode_csi(encode_csi(block)), decode_csi_map(b"".join(encode_csi_map(block)))):
        assert_same_frames(decoded, block)
        assert decoded.seq == block.seq


@given(csi_blocks())
def test_both_forms_have_the_same_fields(block: CsiBlock) -> None:
    values = msgpack.unpackb(b"".join(encode_csi_map(block)))
    assert list(values)[-1] == "csi"
    assert values.pop("csi") == bytes(encode_csi(block)[1])
    assert values == header_of(block)


def test_complex_samples_are_not_copied() -> None:
    block = some_block(4)
    header, csi = encode_csi(block)
    assert np.shares_memory(np.frombuffer(csi, np.uint8), block.csi)
    assert np.shares_memory(decode_csi([header, csi]).csi, block.csi)


def test_samples_at_an_odd_address_are_aligned() -> None:
    block = some_block(4)
    header, csi = encode_csi(block)
    memory = bytearray(len(csi) + 8)
    for start in range(8):
        memory[start : start + len(csi)] = csi
        decoded = decode_csi([header, memoryview(memory)[start : start + len(csi)]])
        assert decoded.csi.flags.aligned
        assert_same_frames(decoded, block)


@given(
    npst.arrays(np.int16, st.tuples(*[st.integers(1, 4)] * 3, st.just(2))),
    st.floats(1e-6, 1e6),
)
def test_integer_samples_are_interleaved_and_scaled(iq: np.ndarray, scale: float) -> None:
    k = len(iq)
    header = {
        **header_of(some_block(k, antennas=iq.shape[1], subcarriers=iq.shape[2])),
        "dtype": "<i2",
        "scale": scale,
    }
    decoded = decode_csi([msgpack.packb(header), iq.astype("<i2").tobytes()])
    expected = (iq[..., 0] + 1j * iq[..., 1]) * scale
    np.testing.assert_allclose(decoded.csi, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"v": 2}, "version"),
        ({"v": None}, "version"),
        ({"type": "chart"}, "type"),
        ({"array": ""}, "field"),
        ({"array": "x" * 129}, "field"),
        ({"array": b"lab"}, "field"),
        ({"seq": -1}, "field"),
        ({"seq": 2**63}, "field"),
        ({"seq": True}, "field"),
        ({"shape": [5, 4]}, "shape"),
        ({"shape": [5, 4, 0]}, "shape"),
        ({"shape": [5, 4, -3]}, "shape"),
        ({"shape": [5, 4, 3.0]}, "shape"),
        ({"shape": "543"}, "field"),
        ({"shape": [2**62, 2**62, 2**62]}, "size"),
        ({"shape": [5, 3, 3]}, "size"),
        ({"dtype": "<c16"}, "dtype"),
        ({"dtype": ["<c8"]}, "dtype"),
        ({"dtype": "<i2"}, "size"),
        ({"ue": b""}, "size"),
        ({"ue": [1, 2, 3, 4, 5]}, "field"),
        ({"time_ns": b"\0" * 41}, "size"),
        ({"position": b"\0" * 12}, "size"),
        ({"position": None}, "field"),
    ],
)
def test_what_does_not_fit_has_a_reason(changes: dict[str, Any], reason: str) -> None:
    header, csi = encode_csi(some_block(5))
    assert reason_of(decode_csi, [msgpack.packb({**msgpack.unpackb(header), **changes}), csi]) == reason


@pytest.mark.parametrize("scale", [None, 0, -1.0, math.nan, math.inf, 1e300, 1e-300, "1", True])
def test_a_scale_must_be_a_positive_number(scale: object) -> None:
    header = {**header_of(some_block(5)), "dtype": "<i2", "scale": scale}
    assert reason_of(decode_csi, [msgpack.packb(header), b"\0" * 240]) == "scale"


@pytest.mark.parametrize("missing", ["array", "seq", "shape", "ue", "time_ns"])
def test_every_field_is_needed(missing: str) -> None:
    header, csi = encode_csi(some_block(5))
    values = msgpack.unpackb(header)
    del values[missing]
    assert reason_of(decode_csi, [msgpack.packb(values), csi]) == "field"


@pytest.mark.parametrize("n", [0, 1, 3])
def test_a_csi_message_has_two_parts(n: int) -> None:
    assert reason_of(decode_csi, [b"x"] * n) == "parts"


def test_a_header_beyond_reason_is_not_even_parsed() -> None:
    assert reason_of(decode_csi, [b"\x90" * (MAX_HEADER_BYTES + 1), b""]) == "size"


def test_deep_nesting_is_refused() -> None:
    assert reason_of(decode_csi, [b"\x91" * 1_000_000 + b"\xc0", b""]) == "header"


@given(st.lists(st.binary(max_size=200), max_size=3))
def test_any_bytes_are_a_block_or_a_wire_error(parts: list[bytes]) -> None:
    assert is_a(CsiBlock, outcome(decode_csi, parts))
    assert is_a(CsiBlock, outcome(decode_csi_map, b"".join(parts)))


@given(st.data())
def test_any_values_are_a_block_or_a_wire_error(data: st.DataObject) -> None:
    """Well-formed msgpack with fields replaced: much deeper in than random bytes come."""
    header, csi = encode_csi(some_block(2))
    values = msgpack.unpackb(header)
    for name in data.draw(st.lists(st.sampled_from([*values, "scale"]), min_size=1, max_size=3)):
        values[name] = data.draw(plain_values | st.sampled_from(["<c8", "<i2", 1, [2, 4, 3], [1, 8, 3]]))
    samples = data.draw(st.sampled_from([bytes(csi), bytes(csi)[: len(csi) // 2], b""]))
    assert is_a(CsiBlock, outcome(decode_csi, [msgpack.packb(values), samples]))


@given(st.data())
def test_a_flipped_byte_is_a_block_or_a_wire_error(data: st.DataObject) -> None:
    header, csi = encode_csi(some_block(2))
    damaged = bytearray(header)
    damaged[data.draw(st.integers(0, len(header) - 1))] ^= data.draw(st.integers(1, 255))
    assert is_a(CsiBlock, outcome(decode_csi, [damaged, csi]))


@given(charts(), st.integers(0, 2**63))
def test_chart_round_trip(chart: ChartUpdate, seq: int) -> None:
    number, decoded = decode_chart(encode_chart(chart, seq))
    assert number == seq
    assert (decoded.array, decoded.method) == (chart.array, chart.method)
    assert decoded.columns.keys() == chart.columns.keys()
    for name, values in chart.columns.items():
        assert decoded[name].dtype == values.dtype
        np.testing.assert_array_equal(decoded[name], values)


def test_a_chart_is_plain_lists_for_any_language() -> None:
    chart = some_chart(3)
    body = msgpack.unpackb(encode_chart(chart, 7))
    assert (body["v"], body["type"], body["array"], body["seq"]) == (1, "chart", "lab", 7)
    assert body["method"] == {"theta": "bartlett", "rho": "isq"}
    for name in ("ue", "time_ns", "theta", "rho", "x", "y", "snr", "snapshots"):
        assert body[name] == getattr(chart, name).tolist()
    assert chart_topic("lab") == b"chart.lab"


def test_standard_deviations_may_be_absent() -> None:
    body = msgpack.unpackb(encode_chart(some_chart(3), 0))
    del body["theta_std"], body["rho_std"]
    assert np.isnan(decode_chart(msgpack.packb(body))[1].theta_std).all()


@given(st.data())
def test_any_chart_values_are_a_chart_or_a_wire_error(data: st.DataObject) -> None:
    values = msgpack.unpackb(encode_chart(some_chart(3), 0))
    for name in data.draw(st.lists(st.sampled_from(list(values)), min_size=1, max_size=3)):
        values[name] = data.draw(plain_values | st.lists(plain_values, min_size=3, max_size=3))
    assert is_a(tuple, outcome(decode_chart, msgpack.packb(values)))


@given(st.binary(max_size=300))
def test_any_bytes_are_a_chart_or_a_wire_error(body: bytes) -> None:
    assert is_a(tuple, outcome(decode_chart, body))
    assert is_a(dict, outcome(decode_report, "status", body))


@given(st.dictionaries(st.text(), plain_values, max_size=5))
def test_report_round_trip(values: dict[str, Any]) -> None:
    body = encode_report("quality", "lab", 3, 17, {f"my_{k}": v for k, v in values.items()})
    decoded = decode_report("quality", body)
    assert (decoded["array"], decoded["seq"], decoded["time_ns"]) == ("lab", 3, 17)
    assert {f"my_{k}" for k in values} <= decoded.keys()
    assert reason_of(decode_report, "status", body) == "type"
