import re
import struct
import zlib
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from chachart.sources.frontend import packet as packet_module
from chachart.sources.frontend.packet import (
    CsiPacket,
    Heartbeat,
    Hello,
    PacketError,
    SampleFormat,
    csi_packet_bytes,
    decode,
    encode,
    max_packet_bytes,
)


def with_crc(raw: bytes) -> bytes:
    return raw + struct.pack("<I", zlib.crc32(raw))


def csi_raw(**changes: object) -> bytes:
    fields = {"version": 1, "type": 1, "format": 0, "antennas": 1, "subcarriers": 2, "scale": 0.5} | changes
    head = struct.pack("<BBBxIQ", fields["version"], fields["type"], fields["format"], 3, 4)
    body = struct.pack("<QHHf", 5, fields["antennas"], fields["subcarriers"], fields["scale"])
    return with_crc(head + body + bytes([1, 2, 3, 4]))


@given(st.data())
def test_every_packet_survives_the_way_there_and_back(packets, data):
    sent = data.draw(packets)
    raw = encode(sent)
    back = decode(raw)
    assert type(back) is type(sent)
    assert encode(back) == raw
    for name in (
        "seq",
        "time_ns",
        "ue",
        "scale",
        "antennas",
        "subcarriers",
        "carrier_hz",
        "serial",
        "elements",
    ):
        assert getattr(back, name, None) == getattr(sent, name, None)
    if isinstance(sent, CsiPacket):
        assert isinstance(back, CsiPacket)
        assert back.samples.dtype == sent.samples.dtype
        np.testing.assert_array_equal(back.samples, sent.samples)
        assert len(raw) == csi_packet_bytes(*sent.samples.shape[:2], SampleFormat(raw[2]))


REASONS = {"short", "crc", "version", "type", "size", "format", "scale", "samples", "field"}


def outcome(raw: bytes) -> str | object:
    try:
        return decode(raw)
    except PacketError as error:
        return error.reason


@given(st.binary(max_size=400))
def test_any_bytes_are_a_packet_or_a_packet_error(raw):
    assert outcome(raw) in REASONS


@given(st.integers(0, 4), st.integers(0, 4), st.binary(min_size=12, max_size=400))
def test_so_are_any_bytes_with_a_good_crc(kind, fmt, rest):
    result = outcome(with_crc(bytes([1, kind, fmt, 0]) + rest))
    assert isinstance(result, CsiPacket | Hello | Heartbeat) or result in REASONS


@given(st.data())
def test_damage_is_never_accepted(packets, data):
    raw = bytearray(encode(data.draw(packets)))
    where = data.draw(st.integers(0, len(raw) - 1))
    kind = data.draw(st.sampled_from(["flip", "lose", "insert"]))
    if kind == "flip":
        raw[where] ^= data.draw(st.integers(1, 255))
    elif kind == "lose":
        del raw[where : where + data.draw(st.integers(1, 4))]
    else:
        raw[where:where] = data.draw(st.binary(min_size=1, max_size=4))
    with pytest.raises(PacketError):
        decode(bytes(raw))


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", "short"),
        (bytes(20), "crc"),
        (csi_raw(version=2), "version"),
        (csi_raw(type=9), "type"),
        (csi_raw(format=3), "format"),
        (csi_raw(antennas=2), "size"),
        (csi_raw(antennas=0), "size"),
        (csi_raw(antennas=65535, subcarriers=65535), "size"),
        (csi_raw(scale=0.0), "scale"),
        (csi_raw(scale=float("nan")), "scale"),
        (with_crc(struct.pack("<BBBxIQ", 1, 1, 0, 0, 0)), "size"),
        (with_crc(struct.pack("<BBBxIQ", 1, 2, 0, 0, 0)), "size"),
        (with_crc(struct.pack("<BBBxIQ", 1, 3, 0, 0, 1 << 63)), "field"),
        (with_crc(struct.pack("<BBBxIQx", 1, 3, 0, 0, 0)), "size"),
        (encode(Hello(0, 0, 0, 3, 2e9, 1e3, 0.1, "A")), "field"),
        (encode(Hello(0, 0, 2, 3, float("inf"), 1e3, 0.1, "A")), "field"),
        (encode(Hello(0, 0, 2, 3, 2e9, 1e3, 0.1, "A\nB")), "field"),
        (encode(CsiPacket(0, 0, 0, np.full((1, 1, 2), np.inf, "<f4"), 1.0)), "samples"),
    ],
)
def test_each_mistake_has_its_reason(raw, reason):
    with pytest.raises(PacketError) as caught:
        decode(raw)
    assert caught.value.reason == reason


@pytest.mark.parametrize(
    "packet",
    [
        CsiPacket(-1, 0, 0, np.zeros((1, 1, 2), np.int8), 1.0),
        CsiPacket(0, 0, 1 << 64, np.zeros((1, 1, 2), np.int8), 1.0),
        CsiPacket(0, 0, 0, np.zeros((1, 1, 2), np.int64), 1.0),
        CsiPacket(0, 0, 0, np.zeros((1, 1, 3), np.int8), 1.0),
        Hello(0, 0, 65536, 1, 1.0, 1.0, 1.0, ""),
        Hello(0, 0, 1, 1, 1.0, 1.0, 1.0, "é"),
    ],
)
def test_what_does_not_fit_is_refused(packet):
    with pytest.raises(ValueError, match=r"samples|fit|ascii"):
        encode(packet)


@pytest.mark.parametrize(("fmt", "error"), [("INT8", 1 / 254), ("INT16", 1 / 65534), ("FLOAT32", 1e-7)])
def test_quantisation_error_is_half_a_step(fmt, error):
    rng = np.random.default_rng(1)
    csi = (rng.standard_normal((8, 16)) + 1j * rng.standard_normal((8, 16))).astype(np.complex64) * 1e-6
    back = CsiPacket.quantise(0, 0, 0, csi, SampleFormat[fmt]).csi
    peak = max(np.abs(csi.real).max(), np.abs(csi.imag).max())
    assert np.abs((back - csi).real).max() <= error * peak * 1.01
    assert np.abs((back - csi).imag).max() <= error * peak * 1.01


def test_an_all_zero_frame_can_be_sent():
    packet = CsiPacket.quantise(0, 0, 0, np.zeros((2, 2), np.complex64), SampleFormat.INT8)
    assert packet.scale == 1.0
    assert not decode(encode(packet)).csi.any()


def test_the_examples_of_the_page_are_what_the_codec_makes():
    page = Path(packet_module.__file__).with_name("PACKET.md").read_text()
    examples = re.findall(r"^    ([0-9a-f ]{40,})$", page, re.MULTILINE)
    assert [bytes.fromhex(example) for example in examples] == [
        encode(Heartbeat(7, 10**9)),
        encode(Hello(0, 0, 2, 3, 2e9, 312_500.0, 0.075, "A1")),
        encode(CsiPacket(258, 1, 5, np.array([[[1, -1], [127, 0]]], np.int8), 0.5)),
    ]


def test_longest_packet_of_a_shape():
    assert max_packet_bytes(1, 1) == len(encode(Hello(0, 0, 1, 1, 1.0, 1.0, 1.0, "", ((0, 0, 0),))))
    assert max_packet_bytes(32, 32) == csi_packet_bytes(32, 32, SampleFormat.FLOAT32) == 32 + 8192 + 4
