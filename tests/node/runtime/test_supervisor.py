from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from chachart.node.runtime import supervisor
from chachart.node.runtime.child import Child
from chachart.node.runtime.supervisor import STILLBORN_LIMIT, SupervisedChild

DEADLINE_S = 30.0
SETTINGS = {"log_level": logging.INFO, "directory": "nowhere"}


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., SupervisedChild]]:
    """Children that run a module that is none of ours."""
    monkeypatch.setattr(supervisor, "FIRST_DELAY_S", 0.001)
    made = []

    def supervise(module: str, most_deaths: int | None = None) -> SupervisedChild:
        def start() -> Child:
            return Child("worker 0", module, SETTINGS)

        deaths: list[int] = []
        made.append(SupervisedChild("worker 0", start, deaths.append, most_deaths))
        return made[-1]

    yield supervise
    for one in made:
        one.kill()
        if one.child is not None:
            one.child.close(DEADLINE_S)


def check_until(supervised: SupervisedChild, condition: Callable[[str | None], bool]) -> str | None:
    deadline, timer = time.monotonic() + DEADLINE_S, threading.Event()
    while True:
        reason = supervised.check()
        if condition(reason):
            return reason
        assert time.monotonic() < deadline
        timer.wait(0.01)


def test_a_worker_that_never_starts_is_given_up(
    make: Callable[..., SupervisedChild], caplog: pytest.LogCaptureFixture
) -> None:
    supervised = make("no_such_module")
    reason = check_until(supervised, lambda reason: reason is not None)
    assert reason == f"worker 0 cannot start: it died {STILLBORN_LIMIT} times in a row"
    assert "No module named no_such_module" in caplog.text
    assert "exit code 1; restarting" in caplog.text


def test_a_killed_worker_is_restarted(
    make: Callable[..., SupervisedChild], caplog: pytest.LogCaptureFixture
) -> None:
    supervised = make("http.server")  # anything that stays
    supervised.check()
    first = supervised.child
    assert first is not None
    supervised.is_up()
    os.kill(first.pid, signal.SIGKILL)
    check_until(supervised, lambda _: supervised.child not in (None, first))
    assert supervised.restarts == 1
    assert f"worker 0 (process {first.pid}) died: killed by SIGKILL" in caplog.text
    assert not Path(f"/proc/{first.pid}").exists()


def test_a_worker_that_ended_as_told_is_not_restarted(make: Callable[..., SupervisedChild]) -> None:
    supervised = make("this")
    supervised.check()
    assert supervised.child is not None
    assert supervised.child.wait(DEADLINE_S)
    supervised.check()
    assert (supervised.restarts, supervised.child.exit_code()) == (0, 0)


def test_one_that_dies_again_and_again_is_given_up(make: Callable[..., SupervisedChild]) -> None:
    supervised = make("http.server", most_deaths=3)
    for deaths in range(1, 4):
        supervised.check()
        check_until(supervised, lambda _: supervised.child is not None)
        supervised.is_up()
        supervised.kill()
        reason = check_until(supervised, lambda _, n=deaths: supervised.restarts == n)  # type: ignore[misc]
    assert reason == "worker 0 died 3 times within a minute"


def test_one_that_cannot_be_started_just_now_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """No descriptor left, for instance: the node goes on, and the child is there as soon as there is one."""
    monkeypatch.setattr(supervisor, "LONGEST_DELAY_S", 0.0)
    failures = [OSError(24, "Too many open files"), MemoryError(), None]

    def start() -> Child:
        if (failure := failures.pop(0)) is not None:
            raise failure
        return Child("worker 0", "this", SETTINGS)

    one = SupervisedChild("worker 0", start, lambda pid: None)
    for _ in range(3):
        assert one.child is None
        assert one.check() is None
    assert one.child is not None
    assert "Too many open files" in caplog.text
    one.kill()
    one.child.close(DEADLINE_S)
