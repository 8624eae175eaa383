"""Alerts: what is said, of whom and when, as UEs move and reports come."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from chachart.node.data.alerts import AlertSettings
from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.zones import ZoneSettings
from chachart.node.runtime.alert_watch import MOST_NAMED, AlertWatch

SECOND = 1_000_000_000
QUIET: dict[str, Any] = {"quality": None, "antennas": {}}
ROOM = ZoneSettings(name="room", polygon=((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)))


def chart_of(places: dict[int, tuple[float, float]], seconds: dict[int, float] | float) -> ChartUpdate:
    """UEs at x, y, last heard at those seconds."""
    ues = list(places)
    heard = [seconds[ue] if isinstance(seconds, dict) else seconds for ue in ues]
    names = ("theta", "rho", "theta_std", "rho_std", "snr", "snapshots")
    x, y = np.array(list(places.values())).reshape(-1, 2).T
    columns = {"ue": np.array(ues, np.uint64), "x": x, "y": y, **{name: np.zeros(len(ues)) for name in names}}
    columns["time_ns"] = np.array([round(t * SECOND) for t in heard], np.int64)
    return ChartUpdate("lab", Method("bartlett", "bartlett"), **columns)


class Watched:
    """An alert, and its node's chart from second to second."""

    def __init__(self, **keys: Any) -> None:
        self.watch = AlertWatch([AlertSettings.model_validate({"name": "a"} | keys)], [ROOM])

    def says(
        self, at_s: float, places: dict[int, tuple[float, float]] | None = None, **status: Any
    ) -> list[tuple[str, str]]:
        heard = status.pop("heard", at_s)
        chart = None if places is None else chart_of(places, heard)
        events = self.watch.judge(chart, round(at_s * SECOND), QUIET | status, at_s, round(at_s * SECOND))
        return [(event["state"], event["text"]) for event in events]


def test_who_enters_a_zone_and_stays_is_told_once() -> None:
    alert = Watched(on="enter", zone="room", for_s=1.0)
    assert alert.says(0, {1: (5, 5), 2: (50, 5)}) == []
    assert alert.says(0.9, {1: (5, 5), 2: (50, 5)}) == []
    assert alert.says(1.0, {1: (5, 5), 2: (9, 5)}) == [("raised", "UE 1 enters room")]
    assert alert.says(1.5, {1: (5, 5), 2: (50, 5)}) == []  # 2 was there too shortly
    assert alert.says(9.0, {1: (5, 5), 2: (50, 5)}) == []
    assert alert.watch.report()["raised"] == {"a": 1}


def test_who_leaves_a_zone_is_told_and_may_come_back() -> None:
    alert = Watched(on="leave", zone="room", for_s=0, ues=(1,))
    assert alert.says(0, {1: (5, 5), 2: (5, 5)}) == []
    assert alert.says(1, {1: (50, 5), 2: (50, 5)}) == [("raised", "UE 1 leaves room")]
    assert alert.says(2, {1: (50, 5), 2: (50, 5)}) == []
    assert alert.says(3, {1: (5, 5)}) == []
    assert alert.says(4, {1: (50, 5)}) == [("raised", "UE 1 leaves room")]


def test_who_falls_silent_is_held_until_heard_again() -> None:
    alert = Watched(on="silent", limit=5.0, for_s=0, zone="room")
    places = {1: (5.0, 5.0), 2: (50.0, 5.0)}
    assert alert.says(4, places, heard={1: 0.0, 2: 0.0}) == []
    assert alert.says(6, places, heard={1: 0.0, 2: 0.0}) == [("raised", "UE 1 is silent")]
    report = alert.watch.report()
    assert ([held["ue"] for held in report["active"]], report["counts"]) == ([1], {"a": 1})
    assert alert.says(7, places, heard={1: 6.5, 2: 0.0}) == [("ended", "UE 1 is heard again")]
    assert alert.watch.report()["active"] == []


def test_of_very_many_only_some_are_named_and_all_are_counted() -> None:
    alert = Watched(on="enter", zone="room", for_s=0)
    places = dict.fromkeys(range(100), (5.0, 5.0))
    said = alert.says(0, places)
    assert len(said) == MOST_NAMED + 1
    assert said[-1] == ("raised", f"{100 - MOST_NAMED} more UEs: enters room")
    assert alert.watch.report()["raised"] == {"a": 100}


@pytest.mark.parametrize(
    ("keys", "bad", "good", "words"),
    [
        ({"on": "tw", "limit": 0.9}, {"quality": {"tw": 0.85}}, {"quality": {"tw": 0.95}}, "TW 0.8500"),
        (
            {"on": "error", "limit": 3.0},
            {"quality": {"error_m": 4.5}},
            {"quality": None},
            "median error 4.5 m",
        ),
        ({"on": "antenna"}, {"antennas": {"faults": {"3": "dead", "4": "weak"}}}, {}, "antenna 3 is dead"),
    ],
)
def test_the_node_itself(keys: dict[str, Any], bad: dict[str, Any], good: dict[str, Any], words: str) -> None:
    alert = Watched(**keys, for_s=2.0)
    assert alert.says(0, **bad) == []
    assert alert.says(1, **good) == []  # it was so too shortly
    assert alert.says(2, **bad) == []
    assert alert.says(4, **bad) == [("raised", words)]
    assert [held["text"] for held in alert.watch.report()["active"]] == [words]
    assert alert.says(5, **good) == []
    assert alert.says(7, **good) == [("ended", f"no more: {words}")]
    assert alert.watch.report()["active"] == []


def test_rows_without_scale_are_nowhere() -> None:
    watch = AlertWatch([AlertSettings(name="a", on="enter", zone="room", for_s=0)], [ROOM])
    chart = chart_of({1: (5.0, 5.0)}, 0.0)
    columns = chart.columns | {"relative": np.ones(1)}
    without = ChartUpdate(chart.array, chart.method, **columns)
    assert watch.judge(without, 0, QUIET, 0.0, 0) == []
