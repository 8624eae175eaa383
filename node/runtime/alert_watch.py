"""Judges alerts on the chart as it stands, now and then: what that costs does not grow with the frames.

Pure: no sockets, no threads, clocks are passed in.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.alerts import AlertSettings
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.zones import ZoneSettings

log = logging.getLogger(__name__)

MOST_NAMED = 20
"""UEs that an alert names at a time; of more it says only how many."""
KEPT_EVENTS = 50
MOST_ACTIVE = 100
VERBS = {"enter": "enters", "leave": "leaves"}

Event = dict[str, Any]


@dataclass(slots=True)
class _OfUes:
    """What one alert knows of each UE, in the order of their numbers."""

    ue: NDArray[np.uint64] = field(default_factory=lambda: np.zeros(0, np.uint64))
    holds: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))
    other_since: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def take(
        self, ue: NDArray[np.uint64], is_so: NDArray[np.bool_], now_ns: int, for_ns: int
    ) -> NDArray[np.intp]:
        """What is so now of all UEs, sorted; gives where what holds has changed: it was so for long enough.

        UEs that are gone are forgotten, of new ones it does not hold.
        """
        at = np.searchsorted(self.ue, ue)
        known = at < len(self.ue)
        known[known] = self.ue[at[known]] == ue[known]
        holds, since = np.zeros(len(ue), np.bool_), np.full(len(ue), now_ns)
        holds[known], since[known] = self.holds[at[known]], self.other_since[at[known]]
        since[is_so == holds] = now_ns
        changed = np.flatnonzero((is_so != holds) & (now_ns - since >= for_ns))
        holds[changed], since[changed] = is_so[changed], now_ns
        self.ue, self.holds, self.other_since = ue, holds, since
        return changed


class AlertWatch:
    """Knows what holds, and says what has changed. One thread calls `judge`.

    Parameters
    ----------
    alerts, zones
        The sections of the configuration.

    Attributes
    ----------
    alerts
        Those of the configuration.
    """

    def __init__(self, alerts: Sequence[AlertSettings], zones: Sequence[ZoneSettings]) -> None:
        self.alerts = alerts
        self._zones = {zone.name: zone for zone in zones}
        self._of_ues = {alert.name: _OfUes() for alert in alerts}
        self._of_node: dict[str, dict[str, tuple[bool, float, str]]] = {a.name: {} for a in alerts}
        self._raised = {alert.name: 0 for alert in alerts}
        self._recent: deque[Event] = deque(maxlen=KEPT_EVENTS)
        self._number = 0

    def judge(
        self,
        chart: ChartUpdate | None,
        chart_ns: int | None,
        status: Mapping[str, Any],
        now: float,
        now_ns: int,
    ) -> list[Event]:
        """What has changed, see `Sink.on_alert`.

        Parameters
        ----------
        chart, chart_ns
            The chart, and its time.
        status
            The latest report.
        now, now_ns
            The host's monotonic seconds, and its time.
        """
        events: list[Event] = []
        for alert in self.alerts:
            if alert.on in ("enter", "leave", "silent"):
                if chart_ns is not None:
                    events += self._judge_ues(alert, chart, chart_ns)
            else:
                events += self._judge_node(alert, status, now, now_ns)
        for event in events:
            self._number += 1
            event["number"] = self._number
            self._recent.append(event)
            self._raised[event["alert"]] += event["ues"] if event["state"] == "raised" else 0
            log.warning("alert %s: %s", event["alert"], event["text"])
        return events

    def report(self) -> dict[str, Any]:
        """`active`: what holds now {alert, on, ue, zone, text}; `recent` events; `raised`: how often, by
        name; `zones`: the corners of each.

        `counts` says of how many UEs (or antennas, or whether) each holds; UEs in a zone of enter, and out of
        one of leave, are no news: those never hold.
        """
        if not (self.alerts or self._zones):
            return {}
        active: list[dict[str, Any]] = []
        counts = {}
        for alert in self.alerts:
            held = self._held(alert)
            counts[alert.name] = len(held)
            active += held
        return {
            "active": active[:MOST_ACTIVE],
            "counts": counts,
            "recent": list(self._recent),
            "raised": dict(self._raised),
            "zones": {name: zone.outline().round(3).tolist() for name, zone in self._zones.items()},
        }

    def start_over(self) -> None:
        """The source has jumped in time."""
        self._of_ues = {alert.name: _OfUes() for alert in self.alerts}

    def _held(self, alert: AlertSettings) -> list[dict[str, Any]]:
        if alert.on in VERBS:
            return []
        if alert.on == "silent":
            known = self._of_ues[alert.name]
            return [_about(alert, f"UE {ue} is silent", int(ue)) for ue in known.ue[known.holds].tolist()]
        states = self._of_node[alert.name].values()
        return [_about(alert, text) for holds, _, text in states if holds]

    def _judge_ues(self, alert: AlertSettings, chart: ChartUpdate | None, now_ns: int) -> list[Event]:
        if chart is None:
            ue, is_so = np.zeros(0, np.uint64), np.zeros(0, np.bool_)
        else:
            ue, is_so = self._what_is_so(alert, chart, now_ns)
        changed = self._of_ues[alert.name].take(ue, is_so, now_ns, int(alert.for_s * 1e9))
        if alert.on == "leave":  # it holds inside, and is told once it does not any more
            changed, ends = changed[~is_so[changed]], np.zeros(0, np.intp)
        else:
            changed, ends = changed[is_so[changed]], changed[~is_so[changed]]
        verb = VERBS.get(alert.on, "")
        events = _each(alert, ue[changed], "raised", f"{verb} {alert.zone}" if verb else "is silent", now_ns)
        if alert.on == "silent":
            events += _each(alert, ue[ends], "ended", "is heard again", now_ns)
        return events

    def _what_is_so(
        self, alert: AlertSettings, chart: ChartUpdate, now_ns: int
    ) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
        """UEs in order, and of which of them the alert speaks now."""
        order = np.argsort(chart.ue)
        if alert.ues is not None:
            order = order[np.isin(chart.ue[order], np.array(alert.ues, np.uint64))]
        x, y = chart.x[order].astype(np.float64), chart.y[order].astype(np.float64)
        is_so = np.ones(len(order), np.bool_)
        if alert.zone is not None:
            is_so &= self._zones[alert.zone].contains(x, y)
            relative = chart.columns.get("relative")
            if relative is not None:  # without a scale nobody is anywhere
                is_so &= ~(relative[order] > 0)
        if alert.on == "silent":
            assert alert.limit is not None
            is_so &= now_ns - chart.time_ns[order] > int(alert.limit * 1e9)
        return chart.ue[order], is_so

    def _judge_node(
        self,
        alert: AlertSettings,
        status: Mapping[str, Any],
        now: float,
        now_ns: int,
    ) -> list[Event]:
        so_now = dict(_dead(status) if alert.on == "antenna" else _bad(alert, status))
        states = self._of_node[alert.name]
        events: list[Event] = []
        for key in [*so_now, *(key for key in states if key not in so_now)]:
            holds, since, text = states.get(key, (False, now, ""))
            is_so = key in so_now
            text = so_now.get(key, text)
            if is_so == holds:
                states[key] = (holds, now, text)
            elif now - since >= alert.for_s:
                states[key] = (is_so, now, text)
                words = text if is_so else f"no more: {text}"
                events.append({**_about(alert, words), "ues": 1, **_when(is_so, now_ns)})
            else:
                states[key] = (holds, since, text)
            if not is_so and not states[key][0]:
                del states[key]
        return events


def _dead(status: Mapping[str, Any]) -> list[tuple[str, str]]:
    faults = status["antennas"].get("faults", {})
    return [(str(n), f"antenna {n} is dead") for n, fault in faults.items() if fault == "dead"]


def _bad(alert: AlertSettings, status: Mapping[str, Any]) -> list[tuple[str, str]]:
    value = (status["quality"] or {}).get("error_m" if alert.on == "error" else alert.on)
    assert alert.limit is not None
    if value is None or not np.isfinite(value):
        return []
    if alert.on == "error":
        return [("", f"median error {value:.3g} m")] if value > alert.limit else []
    return [("", f"{alert.on.upper()} {value:.4f}")] if value < alert.limit else []


def _about(alert: AlertSettings, text: str, ue: int | None = None) -> dict[str, Any]:
    return {"alert": alert.name, "on": alert.on, "ue": ue, "zone": alert.zone, "text": text}


def _when(raised: bool, now_ns: int) -> dict[str, Any]:
    return {"state": "raised" if raised else "ended", "time_ns": now_ns}


def _each(alert: AlertSettings, ues: NDArray[np.uint64], state: str, what: str, now_ns: int) -> list[Event]:
    """An event for each UE; of very many, one for the rest of them."""
    when = _when(state == "raised", now_ns)
    events = [{**_about(alert, f"UE {ue} {what}", ue), "ues": 1, **when} for ue in ues[:MOST_NAMED].tolist()]
    if (rest := len(ues) - MOST_NAMED) > 0:
        events.append({**_about(alert, f"{rest} more UEs: {what}"), "ues": rest, **when})
    return events
