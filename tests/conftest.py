"""Fixtures of all tests: a test that leaves sockets, threads or processes behind fails."""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Iterator
from multiprocessing import resource_tracker
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from chachart.sources.formats import hdf5_process

# The same examples every time, however busy the machine; `--hypothesis-profile=search` looks for new ones.
settings.register_profile(
    "house", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "search", deadline=None, max_examples=3000, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("house")

GRACE_S = 5.0
_TIMER = threading.Event()


@pytest.fixture(autouse=True)
def _nothing_leaks() -> Iterator[None]:
    before = _held()
    yield
    deadline = time.monotonic() + GRACE_S
    while (left := _held() - before) and time.monotonic() < deadline:
        gc.collect()
        _TIMER.wait(0.02)
    assert not left, f"left behind: {', '.join(sorted(left))}"


def _held() -> set[str]:
    """What this process holds that a test must give back."""
    return _sockets() | _threads() | _children()


def _threads() -> set[str]:
    """Threads, but for what pyzmq keeps for messages sent without a copy, and libraries run by themselves."""
    return {
        f"thread {thread.name} ({thread.ident})"
        for thread in threading.enumerate()
        if not type(thread).__module__.startswith("zmq.") and not isinstance(thread, threading._DummyThread)
    }


def _sockets() -> set[str]:
    found = set()
    for entry in Path("/proc/self/fd").iterdir():
        try:
            target = os.readlink(entry)
        except FileNotFoundError:  # the listing's own descriptor is gone already
            continue
        if target.startswith(("socket:", "/dev/pt")):
            found.add(f"descriptor {target}")
    return found


def _children() -> set[str]:
    """Child processes, but for those kept on purpose: of spawned processes' semaphores, and of HDF5 files."""
    kept = {getattr(resource_tracker._resource_tracker, "_pid", None), hdf5_process.reader.pid}
    found = set()
    for task in Path("/proc/self/task").iterdir():
        try:
            pids = (task / "children").read_text().split()
        except (FileNotFoundError, ProcessLookupError):  # the thread ended meanwhile
            continue
        found.update(f"process {pid}" for pid in pids if int(pid) not in kept)
    return found
