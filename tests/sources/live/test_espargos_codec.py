"""ESPARGOS wire formats: whatever bytes come, a message or a reason."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.data.counters import Counters
from chachart.sources.live.device import CodecError
from chachart.sources.live.espargos import stream, uart
from chachart.sources.live.espargos.message import TONES, SensorCsi, decode_message, encode_message

RNG = np.random.default_rng(3)


def sensor(**changes: object) -> SensorCsi:
    values = np.round(RNG.uniform(-2000, 2000, (len(TONES), 2))) @ [1, 1j]
    plain = {
        "source": 0x001122334455,
        "destination": 0xFFFFFFFFFFFF,
        "sequence": 0x1230,
        "retry": False,
        "calibration": False,
        "time_half_ns": 2 * 5_000_000_000 + 25 * 7,
        "csi": values.astype(np.complex64),
        "rssi_dbm": -61,
        "noise_dbm": -96,
        "channel": 6,
        "secondary": -1,
    }
    return SensorCsi(**{**plain, **changes})  # type: ignore[arg-type]


@given(
    st.integers(0, 2**48 - 1),
    st.integers(0, 0xFFFF),
    st.booleans(),
    st.booleans(),
    st.integers(0, 2**40),
    st.integers(-128, 0),
    st.integers(1, 14),
    st.sampled_from([-1, 0, 1]),
)
def test_a_message_comes_back(
    source: int,
    sequence: int,
    retry: bool,
    calibration: bool,
    units: int,
    rssi: int,
    channel: int,
    secondary: int,
) -> None:
    sent = sensor(
        source=source,
        sequence=sequence,
        retry=retry,
        calibration=calibration,
        time_half_ns=25 * units,
        rssi_dbm=rssi,
        channel=channel,
        secondary=secondary,
    )
    got = decode_message(encode_message(sent))
    assert got is not None
    for name in SensorCsi.__slots__:
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name), err_msg=name)


@pytest.mark.parametrize("gain", [-20, 0, 7, 60])
def test_the_gain_is_undone(gain: int) -> None:
    sent = sensor(csi=(np.exp(1j * TONES) * 1000 / 10 ** (gain / 20)).astype(np.complex64))
    got = decode_message(encode_message(sent, gain))
    assert got is not None
    np.testing.assert_allclose(got.csi, sent.csi, atol=0.8 / 10 ** (gain / 20))


@given(st.data())
def test_a_damaged_message_is_refused(data: st.DataObject) -> None:
    message = bytearray(encode_message(sensor()))
    at = data.draw(st.integers(4, len(message) - 1))
    message[at] ^= data.draw(st.integers(1, 255))
    with pytest.raises(CodecError):
        decode_message(bytes(message))


@given(st.data())
def test_a_message_cut_anywhere_is_refused(data: st.DataObject) -> None:
    message = encode_message(sensor())
    with pytest.raises(CodecError):
        decode_message(message[: data.draw(st.integers(4, len(message) - 1))])


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_of_another_kind_or_a_reason(data: bytes) -> None:
    for message in (data, b"\xac\x0b\xcd\xe4" + data):
        with suppress(CodecError):
            assert decode_message(message) is None


@given(st.binary(max_size=200))
def test_any_bytes_are_fragments_or_a_reason(data: bytes) -> None:
    for packet in (data, b"\xad\xfb\xca\xde" + data):
        with suppress(CodecError):
            assert sum(len(f.data) for f in stream.decode_packet(packet)) <= len(packet)


@given(
    st.lists(st.binary(min_size=1, max_size=60), min_size=1, max_size=5), st.randoms(use_true_random=False)
)
def test_fragments_are_joined_in_any_order(parts: list[bytes], random: object) -> None:
    rejected = Counters()
    reassembly = stream.Reassembly(rejected)
    fragments = [stream.Fragment(5 << 29 | 9, i, len(parts), part) for i, part in enumerate(parts)]
    random.shuffle(fragments)  # type: ignore[attr-defined]
    packets = [next(stream.decode_packet(stream.encode_packet([fragment]))) for fragment in fragments]
    joined = [reassembly.add(fragment, 0.0) for fragment in packets]
    assert joined[:-1] == [None] * (len(parts) - 1)
    assert joined[-1] == b"".join(parts)
    assert {fragment.antenna for fragment in packets} == {5}
    assert rejected.as_dict() == {}


def test_a_message_that_never_becomes_whole_is_counted() -> None:
    rejected = Counters()
    reassembly = stream.Reassembly(rejected)
    assert reassembly.add(stream.Fragment(1, 0, 2, b"a"), 0.0) is None
    assert reassembly.add(stream.Fragment(2, 0, 2, b"b"), stream.KEPT_S + 1) is None
    assert rejected.as_dict() == {"incomplete_message": 1}


@given(st.integers(0, 255), st.integers(0, 65535), st.binary(max_size=100))
def test_a_frame_on_a_serial_line_comes_back(kind: int, number: int, payload: bytes) -> None:
    frame = uart.UartFrame(kind, number, payload)
    assert uart.decode(uart.encode(frame)) == frame


@given(st.binary(max_size=60))
def test_any_bytes_on_a_serial_line_are_a_frame_or_a_reason(data: bytes) -> None:
    for read in (uart.decode, uart.parse_hello, uart.parse_request, uart.parse_response):
        with suppress(CodecError):
            read(data)


@given(st.sampled_from(["GET", "POST"]), st.text(max_size=20), st.binary(max_size=50))
def test_requests_and_answers_come_back(method: str, path: str, body: bytes) -> None:
    assert uart.parse_hello(uart.hello_response("espargos", "rev", 3, 1)) == ("espargos", 3)
    ascii_path = path.encode("ascii", "ignore").decode()
    assert uart.parse_request(uart.request(method, ascii_path, body)) == (ascii_path, body)
    assert uart.parse_response(uart.response(200, b"ok")) == (200, "ok")
