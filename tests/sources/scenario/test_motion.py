import numpy as np

from chachart.config.settings import ArraySettings
from chachart.sources.scenario.layout import AREA_M, place
from chachart.sources.scenario.motion import RandomWaypoint, Static

ARRAY = ArraySettings().geometry()
START = place("vip", 400, ARRAY)
UE = np.arange(400)


def walk(speed=3.0, seed=5):
    return RandomWaypoint(START, ARRAY, speed, seed)


def test_who_stands_still_stays():
    np.testing.assert_array_equal(Static(START).at(UE[::2], np.full(200, 1e6)), START[::2])


def test_a_walk_begins_at_the_start():
    np.testing.assert_allclose(walk().at(UE, np.zeros(400)), START, atol=1e-9)


def test_everybody_walks_at_the_given_speed_and_stays_in_the_area():
    motion, dt = walk(), 0.01
    time = np.arange(0, 3000, 37.0)
    ue = np.repeat(UE[:50], len(time))
    now = motion.at(ue, np.tile(time, 50))
    then = motion.at(ue, np.tile(time, 50) + dt)
    speed = np.linalg.norm(then - now, axis=1) / dt
    assert speed.max() < 3.0 + 1e-6
    assert np.mean(speed < 3.0 - 1e-6) < 0.01  # but in the hundredth of a second of a turn
    for column, (low, high) in zip(now.T, AREA_M, strict=False):
        assert low <= column.min() <= column.max() <= high
    np.testing.assert_array_equal(now[:, 2], 1.5)
    assert np.ptp(now[:, 1]) > 500


def test_position_depends_on_ue_and_time_alone():
    time = np.linspace(0, 5000, 400)
    at_once = walk().at(UE, time)
    motion = walk()
    one_by_one = [motion.at(UE[i : i + 1], time[i : i + 1])[0] for i in reversed(range(400))]
    np.testing.assert_array_equal(at_once, one_by_one[::-1])
    assert not np.allclose(at_once, walk(seed=6).at(UE, time))
