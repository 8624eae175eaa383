import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from chachart.node.data.counters import Counters
from chachart.node.data.elements import grid
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.frontend.packet import CsiPacket, Heartbeat, Hello, SampleFormat, encode
from chachart.sources.frontend.session import WINDOW, Intake, SequenceTracker


def frame(seq: int, time_ns: int = 0, shape: tuple[int, int] = (4, 3), ue: int = 9) -> bytes:
    csi = np.full(shape, seq % 100 + 1 - 2j, np.complex64)
    return encode(CsiPacket.quantise(seq, time_ns, ue, csi, SampleFormat.INT16))


def hello(seq: int = 0, time_ns: int = 0, **changes) -> bytes:
    fields = {"antennas": 4, "subcarriers": 3, "carrier_hz": 2e9, "subcarrier_spacing_hz": 312_500.0}
    fields |= {"element_spacing_m": 0.075, "serial": "A1"} | changes
    return encode(Hello(seq=seq, time_ns=time_ns, **fields))


@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=1, max_size=200), st.integers(0, 30))
def test_losses_are_counted_exactly_across_the_wrap(first, arrives, announced):
    tracker = SequenceTracker()
    tracker.announce(first)
    accepted = [tracker.accept((first + n) % 2**32) for n, here in enumerate(arrives) if here]
    assert all(accepted)
    tracker.announce((first + len(arrives) + announced) % 2**32)
    assert tracker.lost == arrives.count(False) + announced
    assert (tracker.duplicates, tracker.reordered, tracker.restarts) == (0, 0, 0)


@given(st.permutations(range(40)), st.integers(0, 2**32 - 1))
def test_late_frames_are_taken_and_no_longer_lost(order, first):
    tracker = SequenceTracker()
    tracker.announce(first)
    assert all(tracker.accept((first + n) % 2**32) for n in order)
    assert (tracker.lost, tracker.duplicates) == (0, 0)
    assert not any(tracker.accept((first + n) % 2**32) for n in order)
    assert tracker.duplicates == 40


def test_what_lies_too_far_back_is_a_restart():
    tracker = SequenceTracker()
    assert tracker.accept(5000)
    assert tracker.accept(5000 - WINDOW - 2)
    assert tracker.restarts == 1
    assert tracker.accept(5000 - WINDOW - 1)
    assert tracker.lost == 0


@given(st.lists(st.integers(0, 2**32 - 1), max_size=100))
def test_any_numbers_leave_the_tracker_small(numbers):
    tracker = SequenceTracker()
    for seq in numbers:
        tracker.accept(seq)
        assert len(tracker._missing) <= WINDOW
    assert tracker.lost >= 0


def test_frames_come_out_as_sent(array):
    intake = Intake(array, Counters())
    for seq in range(3):
        intake.receive("a", frame(seq, ue=2**64 - 1 - seq), 10**18 + seq)
    block = intake.take()
    assert (block.array, block.seq) == ("lab", 0)
    assert block.ue.tolist() == [2**64 - 1, 2**64 - 2, 2**64 - 3]
    assert block.time_ns.tolist() == [10**18, 10**18 + 1, 10**18 + 2]
    np.testing.assert_allclose(block.csi[:, 0, 0], [1 - 2j, 2 - 2j, 3 - 2j], atol=1e-4)
    assert intake.take() is None


def test_what_is_lost_shows_as_a_gap_in_the_numbers_of_the_blocks(array):
    rejected = Counters()
    intake = Intake(array, rejected)
    for seq in (0, 1, 4):
        intake.receive("a", frame(seq), 1)
    first = intake.take()
    intake.receive("a", encode(Heartbeat(7, 0)), 1)
    intake.receive("a", frame(7), 1)
    intake.receive("a", frame(7), 1)
    second = intake.take()
    assert (first.seq, len(first), second.seq, len(second)) == (0, 3, 7, 1)
    details = intake.details()["front_ends"]["a"]
    assert (details["lost"], details["duplicates"], details["frames"]) == (4, 1, 4)
    assert rejected.as_dict() == {"duplicate": 1}


def test_what_came_damaged_is_no_gap_as_well(array):
    rejected = Counters()
    intake = Intake(array, rejected)
    nothing = encode(CsiPacket.quantise(2, 0, 9, np.zeros((4, 3), np.complex64), SampleFormat.INT16))
    packets = [frame(0), frame(1)[:-1] + b"!", nothing, frame(3), None, frame(5), frame(6)]
    numbers = []
    for packet in packets:
        if packet is not None:
            intake.receive("a", packet, 1)
        if (block := intake.take()) is not None:
            numbers.append(block.seq)
    assert rejected.as_dict() == {"crc": 1, "all_zero": 1}
    assert numbers == [0, 1, 3, 4], "one gap: the frame of which nothing came"
    assert intake.details()["front_ends"]["a"]["lost"] == 2


def test_front_ends_are_counted_apart(array):
    intake = Intake(array, Counters())
    for name, seq in (("a", 0), ("b", 70), ("a", 2), ("b", 71)):
        intake.receive(name, frame(seq), 1)
    details = intake.details()["front_ends"]
    assert {name: d["lost"] for name, d in details.items()} == {"a": 1, "b": 0}


def test_a_restarted_device_begins_anew(array):
    intake = Intake(array, Counters())
    intake.receive("a", hello(), 10**18)
    for seq in range(100):
        intake.receive("a", frame(seq, 10**12 + seq), 10**18 + seq)
    intake.receive("a", hello(), 2 * 10**18)
    intake.receive("a", frame(0, 5), 2 * 10**18)
    details = intake.details()["front_ends"]["a"]
    assert (details["restarts"], details["lost"], details["frames"]) == (1, 0, 101)
    assert details["clock"]["offset_s"] == pytest.approx(2e9)
    assert intake.take().time_ns[-1] == 2 * 10**18


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"antennas": 8}, "antennas = 8, not 4"),
        ({"carrier_hz": 2.4e9}, "carrier_hz = 2.4e+09, not 2e+09"),
        ({"subcarrier_spacing_hz": 15e3}, "subcarrier_spacing_hz = 15000, not 312500"),
        ({"element_spacing_m": 0.05}, "element_spacing_m = 0.05, not 0.075"),
    ],
)
def test_the_frames_of_another_array_are_rejected_and_said_so(array, caplog, changes, said):
    rejected = Counters()
    intake = Intake(array, rejected)
    intake.receive("a", hello(**changes), 1)
    intake.receive("a", frame(0), 1)
    assert intake.take() is None
    assert rejected.as_dict() == {"array_mismatch": 1}
    assert intake.details()["front_ends"]["a"]["mismatches"] == [said]
    assert said in caplog.text
    intake.receive("a", hello(seq=1), 1)
    intake.receive("a", frame(1), 1)
    assert len(intake.take()) == 1


def test_an_unknown_element_spacing_is_not_compared(array):
    intake = Intake(array, Counters())
    intake.receive("a", hello(element_spacing_m=0.0), 1)
    intake.receive("a", frame(0), 1)
    assert len(intake.take()) == 1


def test_frames_of_another_shape_are_rejected(array):
    rejected = Counters()
    intake = Intake(array, rejected)
    intake.receive("a", frame(0, shape=(3, 4)), 1)
    intake.receive("a", b"noise", 1)
    assert intake.take() is None
    assert rejected.as_dict() == {"shape": 1, "short": 1}


@given(st.lists(st.binary(max_size=100), max_size=20))
def test_any_bytes_are_counted_and_nothing_else(array, pieces):
    rejected = Counters()
    intake = Intake(array, rejected)
    for raw in pieces:
        intake.receive("a", raw, 1)
    assert rejected.total() + len(intake) <= len(pieces)


def test_a_front_end_with_other_elements_is_another_array():
    board = ArrayGeometry.of_elements("board", grid(2, 2, 0.075), 3, 2e9, 312_500.0)
    for spacing, wrong in ((0.075, False), (0.08, True)):
        rejected = Counters()
        intake = Intake(board, rejected)
        places = tuple(map(tuple, (grid(2, 2, spacing) + 1.0).tolist()))
        intake.receive("a", hello(elements=places), 10**18)
        intake.receive("a", frame(0), 10**18)
        assert ("array_mismatch" in rejected.as_dict()) == wrong
