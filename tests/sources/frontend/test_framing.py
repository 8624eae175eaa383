import itertools

import hypothesis.strategies as st
from hypothesis import given

from chachart.node.data.counters import Counters
from chachart.sources.frontend.framing import StreamDecoder, encode_frame

PACKET = st.binary(min_size=1, max_size=300)


def chunks(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(c % (len(data) + 1) for c in cuts), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


@given(st.lists(PACKET, max_size=8), st.lists(st.integers(0, 4000), max_size=20))
def test_packets_come_through_however_the_stream_is_cut(packets, cuts):
    counts = Counters()
    decoder = StreamDecoder(300, counts)
    stream = b"".join(encode_frame(p) for p in packets)
    assert [p for chunk in chunks(stream, cuts) for p in decoder.feed(chunk)] == packets
    assert counts.total() == 0


@given(PACKET, PACKET, PACKET, st.data())
def test_damage_to_a_frame_delimiters_included_leaves_its_neighbours_whole(before, hit, after, data):
    frame = bytearray(encode_frame(hit))
    for _ in range(data.draw(st.integers(1, 4))):
        where = data.draw(st.integers(0, max(len(frame) - 1, 0)))
        kind = data.draw(st.sampled_from(["flip", "lose", "insert"]))
        if kind == "insert" or not frame:
            frame[where:where] = data.draw(st.binary(min_size=1, max_size=3))
        elif kind == "lose":
            del frame[where : where + data.draw(st.integers(1, 5))]
        else:
            frame[where] ^= data.draw(st.integers(1, 255))
    decoder = StreamDecoder(300, Counters())
    packets = decoder.feed(encode_frame(before) + bytes(frame) + encode_frame(after))
    assert packets[0] == before
    assert packets[-1] == after


@given(st.lists(st.binary(max_size=600), max_size=20))
def test_any_bytes_leave_it_ready_for_the_next_packet_and_small(stream):
    decoder = StreamDecoder(100, Counters())
    for chunk in stream:
        assert all(len(p) <= 101 for p in decoder.feed(chunk))
        assert len(decoder._partial) <= 101
    assert decoder.feed(encode_frame(b"\x00next\x00"))[-1] == b"\x00next\x00"


def test_errors_are_counted_by_kind():
    counts = Counters()
    decoder = StreamDecoder(100, counts)
    assert decoder.feed(b"\x09abc\0") == []
    assert decoder.feed(b"x" * 1000 + b"\0") == []
    assert [decoder.feed(b"y" * 60) for _ in range(50)] == [[]] * 50
    assert decoder.feed(encode_frame(b"after")) == [b"after"]
    assert counts.as_dict() == {"cobs": 1, "oversize": 2}


def test_a_half_packet_is_forgotten_on_reset():
    decoder = StreamDecoder(100, Counters())
    decoder.feed(encode_frame(b"half a packet")[:6])
    decoder.reset()
    assert decoder.feed(encode_frame(b"whole")) == [b"whole"]
