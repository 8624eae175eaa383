from __future__ import annotations

import numpy as np
import pytest
from chart_samples import some_chart

from chachart.sinks.view.history import WINDOW_S, History


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_the_chart_as_it_was(clock: Clock) -> None:
    history = History(10**7, clock)
    assert history.at(0.0) is None
    for second in range(10):
        for _ in range(10):
            clock.now += 0.125
            history.take(some_chart(3, first_ue=3 * (second % 2), seed=second))
    newest, before = history.at(0.0), history.at(6.0)
    assert newest is not None
    assert before is not None
    assert sorted(newest.ue.tolist()) == list(range(6)), "UEs stay for a while"
    assert not np.array_equal(np.sort(newest.x), np.sort(before.x))
    assert 9 < history.seconds() < 12.5
    clock.now += WINDOW_S + 3
    assert history.at(0.0) is None, "nobody was heard for so long"
    assert history.at(1e6) is None


def test_the_oldest_make_room(clock: Clock) -> None:
    one = some_chart(100)
    size = sum(values.nbytes for values in one.columns.values())
    history = History(5 * size, clock)
    for _ in range(20):
        clock.now += 2.0
        history.take(one)
        clock.now += 2.0
        history.take(one)
    assert history.seconds() == pytest.approx(4 * 4.0)


def test_none_is_kept_where_none_is_wished(clock: Clock) -> None:
    history = History(0, clock)
    for _ in range(5):
        clock.now += 2.0
        history.take(some_chart(3))
    assert history.seconds() == 0.0
