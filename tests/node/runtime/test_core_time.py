from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from node_runs import until

from chachart.node.runtime.core_time import CoreTime


@pytest.fixture
def rivals() -> Iterator[list[int]]:
    """Two processes that want the same core all the time."""
    core = min(os.sched_getaffinity(0))
    spin = f"import os; os.sched_setaffinity(0, [{core}])\nwhile True: pass"
    processes = [subprocess.Popen([sys.executable, "-c", spin]) for _ in range(2)]
    yield [process.pid for process in processes]
    for process in processes:
        process.kill()
        process.wait()


def ran_s(pid: int) -> float:
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) / 1e9


def test_who_shares_a_core_waits_for_it_and_who_is_stopped_does_not(rivals: list[int]) -> None:
    one, other = rivals
    core_time = CoreTime()
    until(lambda: core_time.waited_s(one) > 0.2, "it has waited for its core")

    os.kill(one, signal.SIGSTOP)
    until(lambda: Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()[0] == "T", "it is stopped")
    before = core_time.waited_s(one)
    ran = ran_s(other)
    until(lambda: ran_s(other) > ran + 0.3, "the other one has the core")
    assert core_time.waited_s(one) == before


def test_a_process_that_is_gone_waits_for_nothing() -> None:
    assert CoreTime().waited_s(2**22 + 1) == 0.0
