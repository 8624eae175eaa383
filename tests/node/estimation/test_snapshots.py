"""A whole estimator is saved and restored, in pieces, after changes, merged and split up."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.snapshots import UE, joined, merged
from chachart.node.estimation.state import Snapshot

Build = Callable[..., Any]

METHODS: list[dict[str, Any]] = [
    {"theta": "bartlett", "rho": "bartlett"},
    {"theta": "music", "rho": "lr"},
    {"theta": "mvdr", "rho": "isq"},
    {"theta": "joint", "rho": "joint"},
]


def blocks(world: Any, count: int, start: int = 0) -> list[CsiBlock]:
    rng = np.random.default_rng(start)
    return [
        world.block(0.0, rng.integers(0, 20, rng.integers(1, 9)), phase=False, time_ns=10 * t)
        for t in range(start, start + count)
    ]


def equal(a: ChartUpdate, b: ChartUpdate) -> bool:
    return a.columns.keys() == b.columns.keys() and all(
        np.array_equal(a[name], b[name], equal_nan=True) for name in a.columns
    )


def goes_on_like(one: ChartEstimator, other: ChartEstimator, more: list[CsiBlock]) -> None:
    assert one.ues == other.ues
    assert one.rejected.as_dict() == other.rejected.as_dict()
    for block in more:
        assert equal(one.update(block), other.update(block))
    assert one.rejected.as_dict() == other.rejected.as_dict()


@pytest.mark.parametrize("options", METHODS, ids=lambda o: f"{o['theta']}-{o['rho']}")
def test_an_estimator_goes_on_from_its_snapshot(los: Build, options: dict[str, Any]) -> None:
    world = los(20)
    stream = blocks(world, 40)
    first = ChartEstimator(world.array, max_ues=15, forget_after_s=5e-8, **options)
    for block in stream[:25]:
        first.update(block)
        first.forget(int(block.time_ns[0]))
    second = ChartEstimator(world.array, max_ues=15, forget_after_s=5e-8)  # another method until restored
    second.restore(first.snapshot())
    assert second.method == first.method
    for ue in range(20):
        here, there = first.spectrum(ue), second.spectrum(ue)
        assert (here is None) == (there is None)
        if here is not None and there is not None:
            assert all(np.array_equal(here[key], there[key], equal_nan=True) for key in here)
    goes_on_like(first, second, stream[25:])


@pytest.mark.parametrize("options", METHODS, ids=lambda o: f"{o['theta']}-{o['rho']}")
@pytest.mark.parametrize("rows", [1, 4, 100])
def test_a_copy_in_pieces_is_of_one_moment(los: Build, options: dict[str, Any], rows: int) -> None:
    """Frames, UEs that make room and UEs that are forgotten change the estimator, but not the copy."""
    world = los(20)
    stream = blocks(world, 60)
    copied = ChartEstimator(world.array, max_ues=12, forget_after_s=1e-7, **options)
    undisturbed = ChartEstimator(world.array, max_ues=12, forget_after_s=1e-7, **options)
    for block in stream[:30]:
        copied.update(block)
        undisturbed.update(block)
    copy = copied.copy()
    pieces: list[Snapshot] = []
    later = iter(stream[30:])
    while (piece := copy.piece(rows)) is not None:
        pieces.append(piece)
        block = next(later)
        copied.update(block)
        copied.forget(int(block.time_ns[0]))
    assert not copy.given_up
    restored = ChartEstimator(world.array, max_ues=12, forget_after_s=1e-7, **options)
    restored.restore(joined(pieces))
    goes_on_like(restored, undisturbed, blocks(world, 20, start=60))


@pytest.mark.parametrize("options", METHODS, ids=lambda o: f"{o['theta']}-{o['rho']}")
def test_what_was_touched_since_completes_an_older_snapshot(los: Build, options: dict[str, Any]) -> None:
    world = los(20)
    stream = blocks(world, 50)
    first = ChartEstimator(world.array, max_ues=16, **options)
    saved: list[Snapshot] = []
    for t, block in enumerate(stream[:40]):
        first.update(block)
        if t % 3 == 2 or t == 39:
            copy = first.copy(touched=t > 2)
            touched = copy.ues
            while (piece := copy.piece(3)) is not None:
                saved.append(piece)
    assert touched < first.ues
    second = ChartEstimator(world.array, max_ues=16, **options)
    second.restore(joined(saved))
    goes_on_like(first, second, stream[40:])


def test_a_change_of_method_touches_all_and_ends_a_copy(los: Build) -> None:
    world = los(20)
    estimator = ChartEstimator(world.array)
    estimator.update(world.block(0.0, np.arange(9)))
    whole = estimator.snapshot()
    copy = estimator.copy()
    assert copy.piece(2) is not None
    estimator.set_method("music", "isq")
    assert copy.piece(2) is None
    assert copy.given_up
    estimator.update(world.block(0.0, np.arange(3)))
    changed = estimator.copy(touched=True)
    assert changed.ues == 9
    pieces = []
    while (piece := changed.piece(4)) is not None:
        pieces.append(piece)
    restored = ChartEstimator(world.array)
    restored.restore(joined([whole, *pieces]))
    assert restored.method.theta == "music"
    goes_on_like(estimator, restored, blocks(world, 3, start=60))


def test_a_copy_that_was_given_up_loses_no_touch(los: Build) -> None:
    world = los(20)
    estimator = ChartEstimator(world.array)
    estimator.update(world.block(0.0, np.arange(9)))
    given_up = estimator.copy()
    given_up.piece(2)
    assert estimator.copy(touched=True).ues == 7
    assert given_up.given_up


def test_an_estimator_without_a_ue_has_a_snapshot_too(los: Build) -> None:
    world = los(20)
    estimator = ChartEstimator(world.array, rho="lr")
    estimator.restore(estimator.snapshot())
    assert estimator.ues == 0


@pytest.mark.parametrize("options", METHODS, ids=lambda o: f"{o['theta']}-{o['rho']}")
def test_ues_move_between_estimators(los: Build, options: dict[str, Any]) -> None:
    """Two workers become three: every UE goes on as it would have, and LR knows what both had learnt."""
    world = los(30)
    one, *two = (ChartEstimator(world.array, averaging="mean", **options) for _ in range(3))
    for t in range(4):
        block = world.block(0.0, np.arange(30), phase=False, time_ns=t)
        one.update(block)
        for n, estimator in enumerate(two):
            estimator.update(block.take(np.arange(n, 30, 2)))
    saved = [estimator.snapshot() for estimator in two]
    updates = []
    block = world.block(0.0, np.arange(30), phase=False, time_ns=9)
    block = CsiBlock(block.array, 0, block.ue, block.time_ns, block.csi)
    for n in range(3):
        estimator = ChartEstimator(world.array, averaging="mean", **options)
        estimator.restore(merged(saved, lambda ue, n=n: ue % 3 == n))  # type: ignore[misc]
        assert estimator.ues == 10
        updates.append(estimator.update(block.take(np.arange(n, 30, 3))))
    got, want = ChartUpdate.concatenate(updates), one.update(block)
    got = got.take(np.argsort(got.ue))
    assert np.array_equal(got.snapshots, want.snapshots)
    assert got.theta == pytest.approx(want.theta, rel=1e-5)
    assert got.rho == pytest.approx(want.rho, rel=1e-5)


def test_more_ues_than_fit_leave_out_the_longest_unseen(los: Build) -> None:
    world = los(6)
    first = ChartEstimator(world.array)
    for t in range(6):
        first.update(world.block(0.0, np.array([t]), time_ns=t))
    second = ChartEstimator(world.array, max_ues=2)
    second.restore(first.snapshot())
    assert sorted(second.snapshot()[UE].tolist()) == [4, 5]


def test_a_snapshot_that_does_not_fit_changes_nothing(los: Build) -> None:
    world, other = los(6), los(6, antennas=16)
    estimator = ChartEstimator(world.array)
    estimator.update(world.block(0.0, np.arange(6)))
    foreign = ChartEstimator(other.array)
    foreign.update(other.block(0.0, np.arange(3)))
    with pytest.raises(ValueError, match=r"theta\.bank\.rows\[\] must be complex64 \(32,\)"):
        estimator.restore(foreign.snapshot())
    with pytest.raises(ValueError, match="known is not in the snapshot"):
        estimator.restore({k: v for k, v in estimator.snapshot().items() if k != "known"})
    with pytest.raises(ValueError, match="different methods"):
        merged([estimator.snapshot(), ChartEstimator(world.array, rho="music").snapshot()])
    with pytest.raises(ValueError, match="at least one"):
        joined([])
    assert estimator.ues == 6
