"""The T tracer's wire format: whatever bytes come, events or a reason."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.data.counters import Counters
from chachart.sources.live.device import CodecError
from chachart.sources.live.oai import srs, tracer
from chachart.sources.live.oai.gnb import DESCRIPTIONS, ESTIMATE

EVENTS = st.builds(
    tracer.Event, st.integers(0, 2**62), st.integers(-(2**31), 2**31 - 1), st.binary(max_size=50)
)


@given(st.lists(EVENTS, max_size=5), st.integers(1, 30))
def test_events_come_back_however_the_stream_is_cut(events: list[tracer.Event], size: int) -> None:
    wire = b"".join(map(tracer.encode_event, events))
    stream = tracer.EventStream()
    assert [e for at in range(0, len(wire), size) for e in stream.feed(wire[at : at + size])] == events


@given(st.lists(st.binary(max_size=100), max_size=5))
def test_any_bytes_are_events_or_a_reason(parts: list[bytes]) -> None:
    stream = tracer.EventStream()
    with suppress(CodecError):
        for part in parts:
            for event in stream.feed(part):
                assert len(event.body) <= tracer.LONGEST_EVENT


def test_descriptions_are_read_as_a_gnb_writes_them() -> None:
    found = tracer.parse_descriptions(DESCRIPTIONS)
    assert [d.name for d in found] == [
        "LEGACY_PHY_INFO",
        "GNB_PHY_UL_TICK",
        "GNB_PHY_UL_FREQ_CHANNEL_ESTIMATE",
    ]
    assert found[2] == ESTIMATE
    with pytest.raises(CodecError, match="matrix"):
        tracer.parse_descriptions("ID = X\nFORMAT = matrix,h")


@given(st.text(max_size=200))
def test_any_text_is_descriptions_or_a_reason(text: str) -> None:
    with suppress(CodecError):
        tracer.parse_descriptions("ID = X\n" + text)


@given(
    st.integers(-(2**31), 2**31 - 1),
    st.integers(0, 2**64 - 1),
    st.binary(max_size=20),
    st.binary(max_size=20),
)
def test_arguments_come_back(number: int, long: int, text: bytes, buffer: bytes) -> None:
    kinds = (("int", "a"), ("ulong", "b"), ("string", "c"), ("buffer", "d"))
    description = tracer.Description("X", kinds)
    values = {"a": number, "b": long, "c": text.replace(b"\0", b"."), "d": buffer}
    body = tracer.encode_arguments(description, values)
    assert tracer.decode_arguments(description, body) == values
    for end in range(len(body)):
        with pytest.raises(CodecError):
            tracer.decode_arguments(description, body[:end])


@given(st.binary(max_size=60), st.integers(1, 4))
def test_any_buffer_is_an_estimate_or_a_reason(buffer: bytes, symbols: int) -> None:
    with suppress(CodecError):
        heard = srs.estimate({"rnti": 1, "frame": 2, "antenna": 0, "h": buffer}, symbols)
        assert 4 * symbols * len(heard.tones) == len(buffer)


def test_the_tones_are_those_that_were_sounded_in_ascending_order() -> None:
    tones = np.zeros(64, np.complex64)
    tones[20:45] = np.arange(1, 26)
    pairs = np.fft.ifftshift(tones).view(np.float32).astype("<i2").tobytes()
    heard = srs.estimate({"rnti": 1, "frame": 2, "antenna": 3, "chest": pairs * 2}, symbols=2)
    np.testing.assert_array_equal(heard.tones, tones)
    np.testing.assert_array_equal(srs.used(heard.tones, 4, 6), [3, 7, 11, 15, 19, 23])
    with pytest.raises(CodecError, match="25 tones were sounded, 29 are needed"):
        srs.used(heard.tones, 4, 8)
    with pytest.raises(CodecError, match="nothing"):
        srs.used(np.zeros(64, np.complex64), 4, 8)


def test_an_antenna_that_comes_again_begins_a_new_sounding() -> None:
    rejected = Counters()
    soundings = srs.Soundings(2, rejected)
    one = srs.Estimate(7, 1, 0, 0, np.ones(4, np.complex64))
    other = srs.Estimate(7, 1, 1, 0, np.ones(4, np.complex64))
    assert soundings.add(one, one.tones) is None
    assert soundings.add(one, 2 * one.tones) is None
    whole = soundings.add(other, other.tones)
    np.testing.assert_array_equal(whole, [[2, 2, 2, 2], [1, 1, 1, 1]])
    assert rejected.as_dict() == {"incomplete": 1}
    with pytest.raises(CodecError, match="antenna 2 of 2"):
        soundings.add(srs.Estimate(7, 1, 2, 0, one.tones), one.tones)
