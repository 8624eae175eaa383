from __future__ import annotations

import pytest

from chachart.node.runtime.deadlines import FIRST_S, LEAST_S, Deadlines, Patience


def missed(at: float, heard_at: float, oldest: float | None, typical_s: float | None) -> str | None:
    """Asked every second until `at`."""
    deadlines = Deadlines()
    for now in range(int(at)):
        deadlines.missed(float(now), float(now), None, None)
    return deadlines.missed(at, heard_at, oldest, typical_s)


def test_an_idle_worker_has_to_be_heard_of() -> None:
    assert missed(100, 99, None, 0.01) is None
    assert "not heard of for 6 s" in str(missed(100, 94, None, 0.01))


def test_a_block_may_take_twenty_times_as_long_as_others() -> None:
    assert missed(100, 50, 100 - LEAST_S + 1, 0.01) is None
    assert "waits for its answer" in str(missed(100, 50, 100 - LEAST_S - 1, 0.01))
    assert missed(100, 50, 85, 1.0) is None
    assert missed(100, 50, 79, 1.0) is not None
    assert missed(100, 50, 100 - FIRST_S + 1, None) is None


def test_whoever_was_stopped_itself_gives_everybody_the_full_time() -> None:
    deadlines = Deadlines()
    assert deadlines.missed(0.0, 0.0, None, 0.01) is None
    assert deadlines.missed(60.0, 0.0, None, 0.01) is None
    assert deadlines.missed(61.0, 0.0, None, 0.01) is None
    for now in (62.0, 63.0, 64.0):
        assert deadlines.missed(now, 0.0, None, 0.01) is None
    assert deadlines.missed(65.5, 0.0, None, 0.01) is not None


def test_time_in_which_it_waited_for_a_core_does_not_count() -> None:
    patience = Patience()
    assert patience.overdue_s(0.0, 0.0, 40.0) == 0.0
    assert patience.overdue_s(1.0, 0.0, 40.9) == pytest.approx(0.1)
    assert patience.overdue_s(2.0, 0.0, 41.0) == pytest.approx(1.0)
    assert patience.overdue_s(3.0, 2.5, 41.2) == pytest.approx(0.5), "another sign of life is owed since then"
    assert patience.overdue_s(4.0, 2.5, 41.7) == pytest.approx(1.0)
