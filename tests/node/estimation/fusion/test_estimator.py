"""Blocks of several arrays in, rows of fused and tracked positions out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from chachart.node.data import elements as layouts
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.estimator import FusedEstimator, clock_of
from chachart.node.estimation.fusion.events import Gathering, add_in_phase
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.fusion.receiver import Receiver
from chachart.node.estimation.options import Options
from chachart.node.estimation.snapshots import joined, merged

from .conftest import LIGHT, received

AREA = FusionOptions(area_m=(-20, -20, 20, 20), height_m=1.5)
STEP_NS = 100_000_000


def _board(name: str, x: float, y: float, **fields: Any) -> ArrayGeometry:
    inwards = np.array([-x, -y, 0.0]) / np.hypot(x, y)
    right = np.cross([0.0, 0.0, 1.0], inwards)
    return ArrayGeometry.of_elements(
        name,
        layouts.grid(2, 4, LIGHT / 3.5e9 / 2),
        32,
        3.5e9,
        50e6 / 32,
        position_m=(x, y, 4.0),
        axis=tuple(right.tolist()),
        broadside=tuple(inwards.tolist()),
        clock="hall",
        **fields,
    )


@pytest.fixture
def arrays() -> list[ArrayGeometry]:
    """Three boards in corners of a square of 40 m."""
    return [_board("a", -20.0, -20.0), _board("b", 20.0, -20.0), _board("c", 20.0, 20.0)]


def _block(
    array: ArrayGeometry, positions: NDArray[Any], time_ns: int, ue: NDArray[Any] | None = None
) -> CsiBlock:
    places = np.column_stack([positions, np.full(len(positions), 1.5)])
    site = Receiver(replace(array, tones=None, dead_antennas=(), dead_tones=())).site
    csi = received(site, places)
    ids = np.arange(len(places)) if ue is None else ue
    return CsiBlock(
        array.name,
        0,
        ids.astype(np.uint64),
        np.full(len(places), time_ns),
        csi,
        places.astype(np.float32),
    )


PLACES = np.array([[3.0, -2.0], [-6.0, 8.0], [11.0, 1.0]])


def test_a_row_comes_when_all_arrays_have_received_a_transmission(arrays: list[ArrayGeometry]) -> None:
    estimator = FusedEstimator(arrays, AREA)
    assert estimator.clock == "shared"
    assert not len(estimator.update(_block(arrays[0], PLACES, 0)))
    assert not len(estimator.update(_block(arrays[1], PLACES, 1_000_000)))
    update = estimator.update(_block(arrays[2], PLACES, 2_000_000))
    assert (update.array, len(update)) == ("fused", 3)
    np.testing.assert_allclose(np.column_stack([update.x, update.y]), PLACES, atol=0.02)
    np.testing.assert_allclose(update["z"], 1.5)
    assert update["arrays"].tolist() == [3, 3, 3]
    assert update.time_ns.tolist() == [2_000_000] * 3
    assert (update["x_var"] > 0).all()
    assert estimator.heard.as_dict() == {"a": 3, "b": 3, "c": 3}


def test_blocks_of_several_arrays_are_located_at_once(arrays: list[ArrayGeometry]) -> None:
    one, other = FusedEstimator(arrays, AREA), FusedEstimator(arrays, AREA)
    blocks = [_block(array, PLACES, 0) for array in arrays]
    for block in blocks:
        expected = one.update(block)
    found = other.update_all(blocks)
    np.testing.assert_array_equal(found.ue, expected.ue)
    np.testing.assert_allclose(found.x, expected.x)
    assert other.heard.as_dict() == one.heard.as_dict()


def test_an_array_that_fails_delays_and_then_costs_its_share(arrays: list[ArrayGeometry]) -> None:
    estimator = FusedEstimator(arrays, AREA)
    found = []
    for i in range(20):
        for array in arrays[:2]:
            found += estimator.every(_block(array, PLACES, i * STEP_NS))
    found += estimator.every(None)
    assert sum(map(len, found)) == 20 * 3
    assert all((update["arrays"] == 2).all() for update in found)
    np.testing.assert_allclose(found[-1].x, PLACES[:, 0], atol=0.05)


def test_moving_ues_are_tracked_with_their_velocity(arrays: list[ArrayGeometry]) -> None:
    estimator = FusedEstimator(arrays, AREA, TrackingOptions(motion="walk"))
    for i in range(40):
        for array in arrays:
            update = estimator.update(_block(array, PLACES + np.array([0.12 * i, 0.0]), i * STEP_NS))
    np.testing.assert_allclose(update["vx"], 1.2, atol=0.1)
    np.testing.assert_allclose(update["vy"], 0.0, atol=0.1)
    np.testing.assert_allclose(update.x, PLACES[:, 0] + 0.12 * 39, atol=0.1)


def test_several_transmissions_in_one_block_are_taken_in_turn(arrays: list[ArrayGeometry]) -> None:
    estimator = FusedEstimator(arrays, AREA, TrackingOptions(motion="walk"))
    for array in arrays:
        blocks = [_block(array, PLACES, i * STEP_NS) for i in range(5)]
        updates = estimator.every(CsiBlock.concatenate(blocks))
    assert [len(update) for update in updates] == [3] * 5
    times = [update.time_ns[0] for update in updates]
    assert times == sorted(times)


def test_bad_frames_are_counted_by_reason(arrays: list[ArrayGeometry]) -> None:
    estimator = FusedEstimator(arrays, AREA)
    block = _block(arrays[0], PLACES, 0)
    block.csi[0] = 0
    block.csi[1, 0, 0] = np.nan
    estimator.update(block)
    estimator.update(replace(block, array="d"))
    estimator.update(replace(block, csi=block.csi[:, :4].copy()))
    assert estimator.rejected.as_dict() == {"zero": 1, "not_finite": 1, "unknown_array": 3, "shape": 3}


def test_dead_parts_and_gaps_between_tones_do_not_count(arrays: list[ArrayGeometry]) -> None:
    tones = tuple(k for k in range(32) if k not in (5, 6, 17))
    gapped = [replace(a, tones=tones, subcarriers=29, dead_antennas=(2,)) for a in arrays]
    estimator = FusedEstimator(gapped, AREA)
    for array in arrays:
        block = _block(array, PLACES, 0)
        csi = np.ascontiguousarray(block.csi[:, :, list(tones)])
        csi[:, 2] = 7
        update = estimator.update(replace(block, csi=csi))
    np.testing.assert_allclose(np.column_stack([update.x, update.y]), PLACES, atol=0.05)


def test_clocks_follow_from_descriptions_and_facts(arrays: list[ArrayGeometry]) -> None:
    assert clock_of(arrays, "absolute") == "shared"
    assert clock_of(arrays, "relative") == "offset"
    assert clock_of([replace(a, clock_shares="frequency") for a in arrays], "absolute") == "own"
    assert clock_of([replace(a, clock=None) for a in arrays], "absolute") == "own"
    assert clock_of([replace(arrays[0], clock=None)], "absolute") == "shared"


def test_frames_of_random_phase_add_up() -> None:
    rng = np.random.default_rng(0)
    frame = (rng.standard_normal((1, 4, 6)) + 1j * rng.standard_normal((1, 4, 6))).astype(np.complex64)
    frames = np.concatenate([frame * np.exp(1j * p) for p in (0.3, 2.0, -2.5)]).astype(np.complex64)
    total = np.zeros((2, 4, 6), np.complex64)
    add_in_phase(total, np.array([1, 1, 1]), frames)
    np.testing.assert_allclose(np.abs(total[1]), 3 * np.abs(frame[0]), rtol=1e-5)
    assert not total[0].any()


def test_late_frames_of_other_arrays_are_waited_for() -> None:
    gathering = Gathering([(2, 3), (2, 3)], 20.0)
    csi = np.ones((1, 2, 3), np.complex64)

    def block(name: str, ms: int) -> CsiBlock:
        return CsiBlock(name, 0, np.array([7], np.uint64), np.array([ms * 1_000_000]), csi)

    gathering.add(0, block("a", 0))
    assert gathering.ready() is None
    gathering.add(0, block("a", 300))
    assert gathering.ready() is None
    gathering.add(1, block("b", 10))
    events = gathering.ready()
    assert events is not None
    assert (len(events), events.count[0], gathering.held) == (1, 2, 1)


def test_numbers_of_packets_say_what_belongs_together() -> None:
    gathering = Gathering([(2, 3), (2, 3)], 20.0)

    def block(ms: list[int], packet: list[int]) -> CsiBlock:
        times = np.array(ms) * 1_000_000
        csi = np.ones((len(ms), 2, 3), np.complex64)
        return CsiBlock("", 0, np.full(len(ms), 7, np.uint64), times, csi, packet=np.array(packet, np.uint64))

    gathering.add(0, block([100, 110, 120], [9, 3, 4]))
    assert gathering.ready() is None
    gathering.add(1, block([135, 140], [9, 4]))  # its clock is late by more than packets follow each other
    events = gathering.ready()
    assert events is not None
    assert events.time_ns.tolist() == [135_000_000, 140_000_000]
    assert events.count.tolist() == [2, 2]
    assert gathering.held == 1
    gathering.add(1, block([700], [9]))  # numbers come again
    left = gathering.ready()
    assert left is not None
    assert left.count.tolist() == [1]
    assert gathering.held == 1


def test_an_array_that_is_silent_or_has_gone_on_is_not_waited_for() -> None:
    gathering = Gathering([(2, 3), (2, 3)], 20.0)

    def add(array: int, ue: int, ms: int) -> int:
        csi = np.ones((1, 2, 3), np.complex64)
        block = CsiBlock("", 0, np.array([ue], np.uint64), np.array([ms * 1_000_000]), csi)
        gathering.add(array, block)
        events = gathering.ready()
        return 0 if events is None else len(events)

    assert add(0, 1, 0) == 0
    assert add(1, 2, 90) == 0
    assert add(1, 3, 101) == 1  # UE 1, which array 1 would have been heard of by now
    assert add(0, 1, 150) == 0
    found = [add(0, 1, ms) for ms in range(250, 4000, 100)]
    assert found[-1] == 1
    assert gathering.held == 0  # nobody waits for array 1 any more


@pytest.mark.parametrize("workers", [1, 2])
def test_frames_that_wait_go_with_a_snapshot(arrays: list[ArrayGeometry], workers: int) -> None:
    first, second = (FusedEstimator(arrays, AREA, TrackingOptions(motion="walk")) for _ in range(2))
    for array in arrays:
        first.update(_block(array, PLACES, 0))
    first.update(_block(arrays[0], PLACES, STEP_NS))
    first.update(_block(arrays[1], PLACES, STEP_NS))
    copy = first.copy()
    pieces = []
    while (piece := copy.piece(2)) is not None:
        pieces.append(piece)
    whole = joined(pieces)
    second.restore(whole if workers == 1 else merged([whole], lambda ue: ue < 2))
    last = _block(arrays[2], PLACES, STEP_NS)
    expected, found = first.update(last), second.update(last)
    assert found["arrays"].tolist() == ([3, 3, 3] if workers == 1 else [3, 3])
    np.testing.assert_allclose(found.x, expected.x[: len(found)], atol=1e-6)
    np.testing.assert_allclose(found["vx"], expected["vx"][: len(found)], atol=1e-6)


def test_arrays_need_names_of_their_own(arrays: list[ArrayGeometry]) -> None:
    with pytest.raises(ValueError, match="different names"):
        FusedEstimator([arrays[0], arrays[0]])
    with pytest.raises(ValueError, match="two tones"):
        FusedEstimator([replace(arrays[0], dead_tones=tuple(range(31)))])


def test_delays_of_packet_detection_are_no_shared_clock() -> None:
    array = ArrayGeometry("a", 4, 6, 2e9, 1e6, 0.075)
    with pytest.raises(ValueError, match='clock must be "own" or "offset"'):
        FusedEstimator([array], FusionOptions(clock="shared"), options=Options(delay="relative"))
