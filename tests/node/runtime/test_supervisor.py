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
from chachart.node.runtime.supervisor import STILLBORN_LIMIT, Supervisor

DEADLINE_S = 30.0
SETTINGS = {"log_level": logging.INFO, "directory": "nowhere"}


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Supervisor]]:
    """Supervisors of one child each, which runs a module that is none of ours."""
    monkeypatch.setattr(supervisor, "FIRST_DELAY_S", 0.001)
    made = []

    def supervise(module: str) -> Supervisor:
        deaths: list[tuple[int, int]] = []
        one = Supervisor(
            1, lambda shard: Child(f"worker {shard}", module, SETTINGS), lambda *who: deaths.append(who)
        )
        made.append(one)
        return one

    yield supervise
    for one in made:
        one.kill()
        one.close(DEADLINE_S)


def check_until(supervised: Supervisor, condition: Callable[[str | None], bool]) -> str | None:
    deadline, timer = time.monotonic() + DEADLINE_S, threading.Event()
    while True:
        reason = supervised.check()
        if condition(reason):
            return reason
        assert time.monotonic() < deadline
        timer.wait(0.01)


def test_a_worker_that_never_starts_is_given_up(
    make: Callable[[str], Supervisor], caplog: pytest.LogCaptureFixture
) -> None:
    supervised = make("no_such_module")
    reason = check_until(supervised, lambda reason: reason is not None)
    assert reason == f"worker 0 cannot start: it died {STILLBORN_LIMIT} times in a row"
    assert "No module named no_such_module" in caplog.text
    assert "exit code 1; restarting" in caplog.text


def test_a_killed_worker_is_restarted(
    make: Callable[[str], Supervisor], caplog: pytest.LogCaptureFixture
) -> None:
    supervised = make("http.server")  # anything that stays
    supervised.check()
    [post] = supervised.posts
    first = post.child
    assert first is not None
    supervised.hello(0)
    os.kill(first.pid, signal.SIGKILL)
    check_until(supervised, lambda _: post.child not in (None, first))
    assert post.restarts == 1
    assert f"worker 0 (process {first.pid}) died: killed by SIGKILL" in caplog.text
    assert not Path(f"/proc/{first.pid}").exists()


def test_a_worker_that_ended_as_told_is_not_restarted(make: Callable[[str], Supervisor]) -> None:
    supervised = make("this")
    supervised.check()
    [post] = supervised.posts
    assert post.child is not None
    assert post.child.wait(DEADLINE_S)
    supervised.check()
    assert (post.restarts, post.child.exit_code()) == (0, 0)
