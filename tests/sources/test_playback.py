from __future__ import annotations

import pytest

from chachart.sources.playback import Playback


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_time_goes_on_at_its_speed_and_stands_still_while_paused() -> None:
    clock = Clock()
    playback = Playback(2.0, clock)
    assert not playback.started
    assert playback.now_ns() == 0
    playback.start(10**9)
    clock.now += 1
    assert playback.now_ns() == 3 * 10**9
    playback.change(paused=True)
    clock.now += 5
    assert playback.now_ns() == 3 * 10**9
    playback.change(paused=False, speed=0.5)
    clock.now += 2
    assert playback.now_ns() == 4 * 10**9
    playback.start(0)
    assert playback.now_ns() == 0


def test_a_change_wakes_whoever_waits() -> None:
    playback = Playback(1.0)
    playback.change(paused=True)
    playback.wait(3600.0)
    assert playback.paused
    with pytest.raises(AttributeError):
        playback.paused = False  # type: ignore[misc]
