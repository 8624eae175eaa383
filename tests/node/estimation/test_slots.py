import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chachart.node.estimation.slots import SlotTable
from chachart.node.estimation.state import grown


def ids(*values: int) -> np.ndarray:
    return np.array(values, np.uint64)


def at(*values: int) -> np.ndarray:
    return np.array(values, np.int64)


def test_same_ue_keeps_its_slot() -> None:
    table = SlotTable()
    first = table.assign(ids(10, 2**64 - 1, 10, 0), at(1, 2, 3, 4))
    again = table.assign(ids(0, 10, 2**64 - 1), at(5, 6, 7))
    assert first.slots[0] == first.slots[2]
    assert sorted(first.new) == sorted(set(first.slots))
    assert list(again.slots) == [first.slots[3], first.slots[0], first.slots[1]]
    assert len(again.new) == 0
    assert list(table.snapshot(again.slots)["last_seen[]"]) == [5, 6, 7]
    assert len(table) == 3


def test_unknown_ue_has_no_slot() -> None:
    table = SlotTable()
    table.assign(ids(1), at(0))
    assert list(table.lookup(ids(1, 2, 3)) >= 0) == [True, False, False]


def test_removed_slots_are_given_again() -> None:
    table = SlotTable(max_ues=4)
    slots = table.assign(ids(1, 2, 3, 4), at(1, 2, 3, 4)).slots
    table.remove(slots[1:3])
    assert list(table.lookup(ids(1, 2, 3, 4)) >= 0) == [True, False, False, True]
    back = table.assign(ids(8, 9), at(5, 5))
    assert set(back.new) == set(slots[1:3])
    assert len(back.evicted) == 0


def test_the_longest_unseen_makes_room() -> None:
    table = SlotTable(max_ues=3)
    table.assign(ids(1, 2, 3), at(10, 20, 30))
    table.assign(ids(1), at(40))
    assert list(table.assign(ids(4), at(50)).evicted) == [2]
    assert list(table.assign(ids(5), at(60)).evicted) == [3]
    assert set(table.ues(table.slots)) == {1, 4, 5}


def test_a_ue_of_the_block_itself_never_makes_room() -> None:
    table = SlotTable(max_ues=2)
    table.assign(ids(1, 2), at(1, 2))
    assert list(table.assign(ids(1, 3), at(3, 3)).evicted) == [2]


def test_one_slot_only() -> None:
    table = SlotTable(max_ues=1)
    for n in range(20):
        assert list(table.assign(ids(n), at(n)).slots) == [0]
        assert list(table.lookup(ids(n, n + 1))) == [0, -1]


def test_more_ues_in_a_block_than_fit() -> None:
    with pytest.raises(ValueError, match="max_ues is 2, but one block has 3 UEs"):
        SlotTable(max_ues=2).assign(ids(1, 2, 3), at(1, 2, 3))
    with pytest.raises(ValueError, match="max_ues"):
        SlotTable(max_ues=0)


def test_unseen_since() -> None:
    table = SlotTable()
    slots = table.assign(ids(1, 2, 3), at(10, 20, 30)).slots
    assert list(table.unseen_since(20)) == [slots[0]]


def test_a_late_frame_does_not_turn_back_last_seen() -> None:
    table = SlotTable()
    slots = table.assign(ids(1), at(10)).slots
    table.assign(ids(1), at(5))
    assert list(table.snapshot(slots)["last_seen[]"]) == [10]


def test_a_million_ues() -> None:
    table = SlotTable(max_ues=1_000_000)
    ue = np.random.default_rng(1).permutation(1_000_000).astype(np.uint64) << np.uint64(20)
    slots = np.concatenate([table.assign(u, np.zeros(len(u), np.int64)).slots for u in np.split(ue, 16)])
    assert len(np.unique(slots)) == len(table) == table.capacity == 1_000_000
    assert np.array_equal(table.lookup(ue), slots)
    assert np.array_equal(table.ues(slots), ue)


def test_grown_keeps_rows_and_appends_zeros() -> None:
    assert grown(np.ones((2, 3)), 4).sum(axis=1).tolist() == [3, 3, 0, 0]


@settings(deadline=None, max_examples=60)
@given(
    max_ues=st.integers(1, 12),
    blocks=st.lists(
        st.tuples(st.lists(st.integers(0, 25), min_size=1, max_size=12), st.integers(0, 3)), max_size=25
    ),
)
def test_behaves_like_a_dictionary_that_evicts(max_ues: int, blocks: list[tuple[list[int], int]]) -> None:
    table = SlotTable(max_ues)
    seen: dict[int, int] = {}
    for now, (block, removals) in enumerate(blocks):
        ue = block[:max_ues]
        got = table.assign(ids(*ue), np.full(len(ue), now, np.int64))
        evicted = {int(u) for u in got.evicted}
        kept = {u: t for u, t in seen.items() if u not in evicted}
        assert len(evicted) == max(len(seen | dict.fromkeys(ue, 0)) - max_ues, 0)
        others = [t for u, t in kept.items() if u not in ue]
        assert all(seen[u] <= min(others, default=now) for u in evicted)
        seen = kept | dict.fromkeys(ue, now)
        assert {
            int(u): int(t)
            for u, t in zip(table.ues(table.slots), table.snapshot(table.slots)["last_seen[]"], strict=True)
        } == seen
        assert list(table.ues(got.slots)) == ue
        gone = sorted(seen)[:removals]
        table.remove(table.lookup(ids(*gone)))
        for u in gone:
            del seen[u]
        assert len(table) == len(seen) <= max_ues
        assert table.capacity <= max_ues
