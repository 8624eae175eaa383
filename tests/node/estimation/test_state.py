"""Whatever is kept by slot comes back from a snapshot exactly, into any slots."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.amplitude import Isq, Lr
from chachart.node.estimation.covariance import Grouping
from chachart.node.estimation.joint import JointLocator
from chachart.node.estimation.locator import Columns, Locator
from chachart.node.estimation.options import AMPLITUDE, SPECTRAL, Options
from chachart.node.estimation.phase_watch import PhaseWatch
from chachart.node.estimation.separate import SeparateLocator
from chachart.node.estimation.slots import SlotTable
from chachart.node.estimation.state import ROWS, SlotState

Build = Callable[..., Any]

WIDE = {"subcarrier_spacing_hz": 312.5e3}
LOCATORS: list[dict[str, Any]] = [
    *({"theta": method, "rho": method} for method in SPECTRAL),
    *({"theta": "music", "rho": "minnorm", "signal_order": order} for order in (2, "threshold", "mdl")),
    *({"rho": rho, "amplitude": a} for rho in AMPLITUDE for a in ("debiased", "coherent", "noisy")),
    *({"theta": "joint", "rho": "joint", "phase": phase} for phase in ("auto", "steady", "random")),
]


def name(options: dict[str, Any]) -> str:
    return "-".join(map(str, options.values()))


def locator(array: ArrayGeometry, options: dict[str, Any]) -> Locator:
    make = JointLocator if options.get("theta") == "joint" else SeparateLocator
    made: Locator = make(array, Options(**options))
    return made


def take(at: Locator, block: CsiBlock, slots: np.ndarray) -> Columns:
    position = np.full((len(slots), 3), np.nan, np.float32) if block.position is None else block.position
    return at.estimate(Grouping(slots), at.features(block.csi), position)


@pytest.mark.parametrize("phase", [True, False], ids=["turning", "steady"])
@pytest.mark.parametrize("options", LOCATORS, ids=name)
def test_a_locator_goes_on_from_a_snapshot_in_other_slots(
    los: Build, options: dict[str, Any], phase: bool
) -> None:
    world = los(12, **WIDE)
    first = locator(world.array, options)
    first.resize(12)
    for _ in range(8):
        take(first, world.block(0.0, np.arange(12), phase=phase), np.arange(12))
    some, others = np.array([7, 2, 9]), np.array([0, 4, 1])
    second = locator(world.array, options)
    second.resize(5)
    second.restore(first.snapshot(some), others)
    for _ in range(2):
        block = world.block(0.0, some, phase=phase)
        a, b = take(first, block, some), take(second, block, others)
        assert a.keys() == b.keys() >= {"theta", "rho", "theta_std", "rho_std", "snr", "snapshots"}
        for column in a:
            assert np.array_equal(a[column], b[column], equal_nan=True), column


def states(of: SlotState) -> Iterator[SlotState]:
    yield of
    for child in of.children.values():
        yield from states(child)


@pytest.mark.parametrize("options", LOCATORS, ids=name)
def test_everything_with_rows_is_in_the_tree(los: Build, options: dict[str, Any]) -> None:
    """No state, and no array that grew to the number of slots, is held beside what a snapshot has."""
    capacity = 4099
    tree = locator(los(2, **WIDE).array, options)
    tree.resize(capacity)
    known = {id(state) for state in states(tree)}
    for state in states(tree):
        for attribute, value in vars(state).items():
            if isinstance(value, SlotState):
                unused = not any(len(rows) for rows in value.snapshot().values() if rows.ndim)
                assert id(value) in known or unused, attribute
            elif isinstance(value, np.ndarray) and value.shape[:1] == (capacity,):
                assert attribute in state.BY_SLOT
    snapshot = tree.snapshot(np.arange(3))
    rows = [value for key, value in snapshot.items() if key.endswith(ROWS)]
    assert rows
    assert all(len(value) == 3 for value in rows)


def test_what_does_not_fit_changes_nothing(los: Build) -> None:
    world = los(3, **WIDE)
    at = locator(world.array, {"theta": "music", "rho": "lr"})
    at.resize(3)
    take(at, world.block(0.0, np.arange(3)), np.arange(3))
    before = at.snapshot()
    other = locator(world.array, {"theta": "bartlett", "rho": "lr"})
    other.resize(3)
    with pytest.raises(ValueError, match=r"theta\.bank\.rows\[\] must be complex64 \(32, 32\)"):
        at.restore(other.snapshot())
    missing = {key: value for key, value in before.items() if key != "ranging.sums"}
    with pytest.raises(ValueError, match=r"ranging\.sums is not in the snapshot"):
        at.restore(missing)
    with pytest.raises(ValueError, match="rows, instead of all alike"):
        at.restore(before | {"weights.sum.rows[]": np.zeros(2)})
    for key, value in at.snapshot().items():
        assert np.array_equal(value, before[key]), key


def same(a: SlotState, b: SlotState) -> bool:
    mine, other = a.snapshot(), b.snapshot()
    return mine.keys() == other.keys() and all(np.array_equal(mine[k], other[k]) for k in mine)


def test_isq_lr_and_phase_watch_round_trip() -> None:
    rng = np.random.default_rng(0)
    s, rho = rng.uniform(1, 9, 8), rng.uniform(50, 500, 8)
    isq, lr, watch = Isq(None), Lr(6, log_range=True), PhaseWatch(1.0)
    for state in (isq, lr, watch):
        state.resize(8)
    position = rng.uniform(-500, 500, (8, 3))
    isq.ranges(np.arange(8), s, rho, position)
    lr.ranges(np.arange(8), s, rho, position)
    csi = (rng.standard_normal((8, 4, 4, 2)) @ [1, 1j]).astype(np.complex64)
    watch.look(Grouping(np.arange(8)), csi, 3 * csi, np.ones(8, np.bool_))
    fresh_isq, fresh_lr, fresh_watch = Isq(None), Lr(6, log_range=True), PhaseWatch(1.0)
    pairs: list[tuple[SlotState, SlotState]] = [(isq, fresh_isq), (lr, fresh_lr), (watch, fresh_watch)]
    for state, fresh in pairs:
        assert not same(state, fresh)
        fresh.restore(state.snapshot())
        assert same(state, fresh)
    assert fresh_isq.scale == isq.scale
    assert fresh_lr.fit() == lr.fit()


def test_the_slot_table_round_trips() -> None:
    table = SlotTable(max_ues=100)
    ue = np.random.default_rng(1).integers(0, 2**64, 90, np.uint64)
    table.assign(ue, np.arange(90))
    table.remove(table.lookup(ue[10:40]))
    fresh = SlotTable(max_ues=100)
    fresh.restore(table.snapshot(), table.slots)
    assert np.array_equal(fresh.slots, table.slots)
    assert np.array_equal(fresh.lookup(ue), table.lookup(ue))
    assert np.array_equal(
        fresh.snapshot(fresh.slots)["last_seen[]"], table.snapshot(table.slots)["last_seen[]"]
    )
    for t in range(100, 130):  # it goes on: room is made for the same ones
        new = np.array([t, t + 1000], np.uint64)
        both = [side.assign(new, np.full(2, t)) for side in (table, fresh)]
        assert np.array_equal(both[0].evicted, both[1].evicted)
    assert set(fresh.ues(fresh.slots)) == set(table.ues(table.slots))


def test_a_slot_table_takes_ues_beside_those_it_has() -> None:
    table = SlotTable(max_ues=10)
    table.assign(np.array([1, 2, 3], np.uint64), np.array([1, 2, 3]))
    moved = {"ue[]": np.array([2, 9], np.uint64), "last_seen[]": np.array([7, 8])}
    table.restore(moved, np.array([5, 0]))
    assert table.lookup(np.array([1, 2, 3, 9], np.uint64)).tolist() == [-1, 5, 2, 0]
    assert table.snapshot(np.array([5, 0]))["last_seen[]"].tolist() == [7, 8]
    assert len(table) == 3
    with pytest.raises(ValueError, match="each once"):
        table.restore({"ue[]": np.array([2, 2], np.uint64), "last_seen[]": np.array([7, 8])})


@pytest.mark.parametrize("options", LOCATORS, ids=name)
def test_bytes_of_a_slot_are_what_is_kept(los: Build, options: dict[str, Any]) -> None:
    tree = locator(los(2, **WIDE).array, options)
    tree.resize(100)
    rows = [value for key, value in tree.snapshot().items() if key.endswith(ROWS)]
    assert tree.bytes_per_slot == sum(value.nbytes for value in rows) / 100


def test_bytes_of_a_slot_table_are_at_least_what_is_kept() -> None:
    table = SlotTable(max_ues=1000)
    table.assign(np.arange(1000, dtype=np.uint64), np.zeros(1000, np.int64))
    kept = sum(value.nbytes for value in vars(table).values() if isinstance(value, np.ndarray))
    assert 500 * table.bytes_per_slot < kept <= 1100 * table.bytes_per_slot
