"""How a node is, why, and what would help: one answer for page, panel, log, /readyz and `ctl status`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

QUIET_S = 5.0
"""A live source without frames for so long is worth a word."""
ONE_QUIET_S = 3.0
"""One of several sources without frames for so long, too."""
LATELY_S = 5.0

Trouble = tuple[str, str]
"""Reason and fix."""


@dataclass(frozen=True, slots=True)
class Condition:
    """`running` with nothing to say, `degraded` with reason and fix, or what the node does instead."""

    state: str
    reason: str | None = None
    fix: str | None = None


@dataclass(frozen=True, slots=True)
class _Then:
    at: float
    frames_in: int
    rejected: dict[str, int]
    restamped: int
    workers: tuple[int, ...]


class ConditionWatch:
    """Judges one status report after the other. Pure: the clock is passed in."""

    def __init__(self) -> None:
        self._then: _Then | None = None
        self._frames_in = -1
        self._frame_at = 0.0

    def judge(self, status: dict[str, Any], now: float) -> Condition:
        """How the node is.

        Parameters
        ----------
        status
            A `NodeStatus` as plain values, whose `state` is what the node is doing.
        now
            Monotonic seconds.
        """
        if status["frames_in"] != self._frames_in:
            self._frames_in, self._frame_at = status["frames_in"], now
        recent = self._recent(status, now)
        if status["state"] == "starting":
            if (trouble := next(_lacking(status), None)) is not None:
                return Condition("starting", *trouble)
            missing = [str(w["shard"]) for w in status["workers"] if w["pid"] is None]
            waits = f"waiting for worker {', '.join(missing)}" if missing else "the source is being opened"
            return Condition("starting", waits)
        if status["state"] != "running":
            return Condition(status["state"])
        found = next(self._troubles(status, recent, now), None)
        return Condition("running") if found is None else Condition("degraded", *found)

    def _recent(self, status: dict[str, Any], now: float) -> _Then:
        """What there was a while ago, to tell what happens now from what once happened."""
        untrained = tuple(worker.get("untrained", 0) for worker in status["workers"])
        latest = _Then(now, status["frames_in"], dict(status["rejected"]), status["restamped"], untrained)
        if self._then is None:
            self._then = latest
        then = self._then
        if now - then.at > LATELY_S:
            self._then = latest
        return then

    def _troubles(self, status: dict[str, Any], then: _Then, now: float) -> Iterator[Trouble]:
        """Everything that is wrong, the worst first."""
        yield from _processes(status)
        yield from self._input(status, then, now)
        yield from _sources(status)
        yield from _disks(status)
        yield from _estimates(status, then)
        yield from _antennas(status["antennas"])

    def _input(self, status: dict[str, Any], then: _Then, now: float) -> Iterator[Trouble]:
        rejected = {
            reason: n - then.rejected.get(reason, 0)
            for reason, n in status["rejected"].items()
            if n > then.rejected.get(reason, 0)
        }
        nothing_good = status["frames_in"] == then.frames_in
        if rejected and nothing_good:
            counts = ", ".join(f"{n} {reason}" for reason, n in sorted(rejected.items()))
            why = status["complaint"] or counts
            yield f"all that comes is rejected: {why}", "make [array] and the front-end agree"
        elif (restamped := status["restamped"] - then.restamped) > 0:
            yield (
                f"clocks apart: {restamped} frames had another time than this host",
                "set the clock of the front-end, or [array] time_tolerance_s",
            )
        quiet = now - self._frame_at
        if not status["lossless"] and quiet > QUIET_S and not rejected:
            where = status["source_details"].get("endpoint") or status["source"]
            yield f"no frames for {quiet:.0f} s", f"is the front-end on, and does it send to {where}?"


def _processes(status: dict[str, Any]) -> Iterator[Trouble]:
    wait = "it is started again by itself; look into the log if that goes on"
    if status["feeder_pid"] is None:
        yield "the feeder process is being restarted", wait
    else:
        yield from _lacking(status)
        for worker in status["workers"]:
            if worker["pid"] is None:
                yield f"worker {worker['shard']} is being restarted", wait


def _lacking(status: dict[str, Any]) -> Iterator[Trouble]:
    """Workers that cannot read what was learnt."""
    for worker in status["workers"]:
        if worker.get("lacks"):
            yield (
                f"worker {worker['shard']} cannot read its snapshots: {worker['lacks']}",
                "make [state] directory reachable from where it runs; it is tried again by itself",
            )


def _sources(status: dict[str, Any]) -> Iterator[Trouble]:
    """Those of several sources that have stopped; the others go on."""
    for source in status["sources"]:
        which, quiet = f"array {source['name']}", source["quiet_s"]
        if source["ended"] or not source["live"]:
            continue
        if quiet > ONE_QUIET_S:
            yield (
                f"{which}: nothing for {quiet:.0f} s",
                f"is it on, and heard by source {source['type']}?",
            )
        elif source["pid"] is None:
            yield f"{which}: its source is being restarted", "look into the log if that goes on"


def _antennas(report: dict[str, Any]) -> Iterator[Trouble]:
    """Those that are dead, and else those that are weak or saturated."""
    faults, dead_s = report.get("faults", {}), report.get("dead_s", {})
    silent = [f"antenna {n}: nothing for {dead_s[n]:.0f} s" for n in sorted(faults, key=int) if n in dead_s]
    others = [f"antenna {n} {faults[n]}" for n in sorted(faults, key=int) if n not in dead_s]
    if silent or others:
        yield ", ".join(silent + others), "look at its cable, or list it in dead_antennas of [array]"


def _disks(status: dict[str, Any]) -> Iterator[Trouble]:
    for sink in status["sinks"]:
        if sink.get("trouble"):
            yield f"sink {sink['name']}: {sink['trouble']}", "make room there; it begins a new file by itself"
    errors = [w["snapshot_error"] for w in status["workers"] if w.get("snapshot_error")]
    if status["state_error"] or errors:
        reason = status["state_error"] or f"snapshots cannot be written: {errors[0]}"
        yield reason, "make room in [state] directory: what is learnt now would not outlive a crash"


def _estimates(status: dict[str, Any], then: _Then) -> Iterator[Trouble]:
    untrained = sum(worker.get("untrained", 0) for worker in status["workers"])
    if untrained > sum(then.workers):
        yield (
            'rho = "lr" is not trained: it has not seen two UEs with a known position',
            "send known positions, or choose another rho",
        )
    if status["relative"]:
        yield (
            'rho = "isq" has no scale: distances are relative, not metres',
            "set [estimator] isq_reference, or send known positions",
        )
