from __future__ import annotations

from typing import Any

import pytest

from chachart.node.runtime.condition import Condition, ConditionWatch
from chachart.node.runtime.status import NodeStatus

WORKER = {"shard": 0, "pid": 11, "restarts": 0, "ues": 3}


SOURCE = {"name": "east", "type": "zmq", "pid": 9, "live": True, "quiet_s": 0.0, "ended": False}


def status(**changes: Any) -> dict[str, Any]:
    values = {"state": "running", "source": "zmq", "frames_in": 100, "feeder_pid": 10, "workers": [WORKER]}
    return NodeStatus(**(values | changes)).as_dict()


def judged(*reports: dict[str, Any], every_s: float = 1.0) -> Condition:
    """What is said of the last of some reports."""
    watch = ConditionWatch()
    for number, report in enumerate(reports):
        condition = watch.judge(report, number * every_s)
    return condition


def test_a_node_that_runs_has_nothing_to_say() -> None:
    assert judged(status(), status(frames_in=200)) == Condition("running")


@pytest.mark.parametrize("state", ["draining", "stopped"])
def test_what_else_a_node_does_is_told(state: str) -> None:
    assert judged(status(state=state)) == Condition(state)


def test_starting_says_who_is_missing() -> None:
    assert (
        judged(status(state="starting", workers=[{**WORKER, "pid": None}])).reason == "waiting for worker 0"
    )
    lacking = judged(status(state="starting", workers=[{**WORKER, "pid": None, "lacks": "s3: 503"}]))
    assert lacking.state == "starting"
    assert "worker 0 cannot read its snapshots: s3: 503" in str(lacking.reason)
    assert "[state] directory" in str(lacking.fix)


@pytest.mark.parametrize(
    ("changes", "reason", "fix"),
    [
        ({"feeder_pid": None}, "the feeder process is being restarted", "log"),
        ({"workers": [{**WORKER, "pid": None}]}, "worker 0 is being restarted", "log"),
        (
            {"workers": [{**WORKER, "pid": None, "lacks": "s3://b is out of reach: 503"}]},
            "worker 0 cannot read its snapshots: s3://b is out of reach: 503",
            "[state] directory",
        ),
        (
            {"rejected": {"shape": 64}, "complaint": "4 x 32 came, the array is 8 x 32", "frames_in": 100},
            "all that comes is rejected: 4 x 32 came, the array is 8 x 32",
            "[array]",
        ),
        ({"rejected": {"header": 3, "crc": 1}, "frames_in": 100}, "rejected: 1 crc, 3 header", "front-end"),
        ({"restamped": 7}, "clocks apart: 7 frames", "time_tolerance_s"),
        (
            {"sinks": [{"name": "recorder", "trouble": "lab.mcap has ended: No space left on device"}]},
            "sink recorder: lab.mcap has ended: No space left on device",
            "make room",
        ),
        ({"workers": [{**WORKER, "snapshot_error": "Read-only file system"}]}, "Read-only", "[state]"),
        ({"state_error": "/state cannot be written to: No space"}, "/state cannot be written", "[state]"),
        ({"workers": [{**WORKER, "untrained": 5}]}, '"lr" is not trained', "known positions"),
        (
            {"sources": [{**SOURCE, "quiet_s": 3.4}, {**SOURCE, "name": "west"}]},
            "array east: nothing for 3 s",
            "source zmq",
        ),
        ({"sources": [{**SOURCE, "pid": None}]}, "array east: its source is being restarted", "log"),
        ({"relative": True}, '"isq" has no scale', "isq_reference"),
        (
            {"antennas": {"faults": {"3": "dead", "5": "weak"}, "dead_s": {"3": 10.2}}},
            "antenna 3: nothing for 10 s, antenna 5 weak",
            "dead_antennas",
        ),
    ],
)
def test_whatever_is_wrong_has_a_reason_and_a_fix(changes: dict[str, Any], reason: str, fix: str) -> None:
    condition = judged(status(), status(**{"frames_in": 200, **changes}))
    assert condition.state == "degraded"
    assert condition.reason is not None
    assert condition.fix is not None
    assert reason in condition.reason
    assert fix in condition.fix


def test_a_live_source_that_says_nothing_is_noticed_and_a_recording_is_not() -> None:
    assert "no frames for 8 s" in str(judged(status(), status(), every_s=8.0).reason)
    assert judged(*[status(lossless=True)] * 2, every_s=8.0) == Condition("running")


def test_what_once_happened_is_forgiven() -> None:
    bad = status(frames_in=200, restamped=7)
    reports = [status(), *(status(frames_in=200 + n, restamped=7) for n in range(15))]
    assert judged(*reports, every_s=2.0) == Condition("running")
    assert judged(status(), bad).state == "degraded"
