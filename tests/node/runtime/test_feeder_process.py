"""What the main process keeps of a feeder that is gone, and when it takes one for hung."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from chachart.node.runtime import deadlines, feeder_process, supervisor
from chachart.node.runtime.child import Child
from chachart.node.runtime.feeder_process import FeederProcess
from chachart.node.runtime.reader import Tally

DEADLINE_S = 30.0
COUNTED = {
    "blocks_in": 4,
    "frames_in": 400,
    "frames_estimated": 390,
    "dropped": {"queue_full": 3},
    "dropped_here": {},
    "rejected": {"crc": 2},
    "gaps": 1,
    "out_of_order": 0,
    "restamped": 0,
    "workers": [{"state_lost": 5, "ues_reset": 1, "frames_replayed": 7, "backlog_blocks": 2}],
}


@pytest.fixture
def given() -> list[dict[str, Any] | None]:
    """What each feeder was told of the one before it."""
    return []


@pytest.fixture
def feeder(
    given: list[dict[str, Any] | None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[FeederProcess]:
    """A process of which the test says what it reports."""
    monkeypatch.setattr(supervisor, "FIRST_DELAY_S", 0.001)

    def start(counted: dict[str, Any] | None) -> Child:
        given.append(counted)
        return Child("feeder", "http.server", {"log_level": logging.INFO, "directory": "nowhere"})

    one = FeederProcess(start, tmp_path / "tally", lambda: None)
    yield one
    one.supervised.kill()
    if one.supervised.child is not None:
        one.supervised.child.close(DEADLINE_S)


def check_until(feeder: FeederProcess, condition: Callable[[], bool]) -> str | None:
    deadline, timer = time.monotonic() + DEADLINE_S, threading.Event()
    while True:
        reason = feeder.check()
        if condition() or reason is not None:
            return reason
        assert time.monotonic() < deadline
        timer.wait(0.01)


def reads(feeder: FeederProcess) -> int:
    """Have it come up; its process id."""
    feeder.ready = True
    feeder.supervised.is_up()
    feeder.reads()
    assert feeder.pid is not None
    return feeder.pid


def test_a_successor_is_told_what_the_dead_one_counted(
    feeder: FeederProcess, given: list[dict[str, Any] | None], tmp_path: Path
) -> None:
    tally = Tally(tmp_path / "tally")
    feeder.check()
    first = reads(feeder)
    feeder.heard(COUNTED)
    tally.set(417)
    os.kill(first, signal.SIGKILL)
    check_until(feeder, lambda: len(given) == 2)
    counted = given[1]
    assert given[0] is None
    assert counted is not None
    assert counted["frames_in"] == 417, "what it read after its last report is in the tally"
    assert (counted["frames_estimated"], counted["dropped"]) == (390, {"queue_full": 3})
    assert feeder.pid is None, "until the successor reads"

    feeder.heard({**COUNTED, "frames_in": 0, "frames_estimated": 0, "dropped": {}, "workers": []})
    assert feeder.status["frames_in"] == 417, "a successor that does not read yet knows of nothing"
    assert [feeder.total(count) for count in ("state_lost", "ues_reset", "frames_replayed")] == [5, 1, 7]
    reads(feeder)
    feeder.heard({**COUNTED, "frames_in": 500})
    assert feeder.status["frames_in"] == 500
    assert feeder.total("state_lost") == 10, "those of both"


def test_three_deaths_within_a_minute_are_enough(feeder: FeederProcess) -> None:
    for deaths in range(1, 4):
        check_until(feeder, lambda: feeder.supervised.child is not None)
        os.kill(reads(feeder), signal.SIGKILL)
        reason = check_until(feeder, lambda n=deaths: feeder.supervised.restarts == n)  # type: ignore[misc]
    assert reason == "the feeder process died 3 times within a minute"


def test_one_that_says_nothing_is_ended_and_that_is_told(
    feeder: FeederProcess, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    feeder.check()
    first = reads(feeder)
    feeder.heard(COUNTED)
    monkeypatch.setattr(feeder_process, "LEAST_S", 0.05)
    monkeypatch.setattr(deadlines, "STALLED_S", DEADLINE_S)
    os.kill(first, signal.SIGSTOP)
    check_until(feeder, lambda: feeder.supervised.child is not None and feeder.supervised.child.pid != first)
    assert feeder.stuck is not None
    assert "not heard of" in feeder.stuck
    assert f"(process {first}) hangs" in caplog.text
    reads(feeder)
    assert feeder.stuck is None


def test_a_silent_source_is_no_fault_while_workers_are_busy(
    feeder: FeederProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeder_process, "READER_WITHIN_S", 0.01)
    feeder.check()
    first = reads(feeder)
    feeder.heard({**COUNTED, "source_silent_s": 1.0})
    feeder.check()
    assert feeder.pid == first
    feeder.heard({**COUNTED, "source_silent_s": 1.0, "workers": [{"backlog_blocks": 0}]})
    check_until(feeder, lambda: feeder.supervised.restarts == 1)
    assert feeder.stuck is not None
    assert "its source gave nothing back" in feeder.stuck


def test_what_an_abandoned_one_leaves_counts_as_dropped(feeder: FeederProcess) -> None:
    feeder.check()
    reads(feeder)
    feeder.heard(COUNTED)
    feeder.abandon()
    assert feeder.status["dropped"] == {"queue_full": 3, "node_failed": 7}
