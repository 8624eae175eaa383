from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.runtime.sink_thread import ASK_EVERY_S, SinkThread
from chachart.sinks.base import NodeAccess, Sink, SinkSettings

ARRAY = ArrayGeometry("lab", 2, 2, 2e9, 1e6, 0.075)
DEADLINE_S = 10.0


class Notebook(Sink):
    """Writes down what it gets; waits while `gate` is closed; fails on demand."""

    Settings = SinkSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self.gate = threading.Event()
        self.gate.set()
        self.busy = threading.Event()
        self.charts: list[ChartUpdate] = []
        self.blocks: list[CsiBlock] = []
        self.reports: list[dict[str, Any]] = []
        self.ticks = 0
        self.failing: Exception | None = None
        self.closed = False

    def open(self, node: NodeAccess | None) -> None:
        if self.failing:
            raise self.failing

    def on_chart(self, update: ChartUpdate) -> None:
        self._wait()
        self.charts.append(update)

    def on_csi(self, block: CsiBlock) -> None:
        self._wait()
        self.blocks.append(block)

    def on_quality(self, report: dict[str, Any]) -> None:
        self.reports.append(report)

    def on_tick(self) -> None:
        self.ticks += 1

    def close(self) -> None:
        if self.failing:
            raise self.failing
        self.closed = True

    def _wait(self) -> None:
        self.busy.set()
        self.gate.wait(DEADLINE_S)
        if self.failing:
            raise self.failing


class Turnstile(threading.Event):
    """A gate that lets one in at a time."""

    def __init__(self) -> None:
        super().__init__()
        self._admissions = threading.Semaphore(0)

    def let_in_one(self) -> None:
        self._admissions.release()

    def wait(self, timeout: float | None = None) -> bool:
        return self._admissions.acquire(timeout=timeout)


@pytest.fixture
def notebook() -> Notebook:
    return Notebook(SinkSettings(type="notebook"), ARRAY)


@pytest.fixture
def started(notebook: Notebook) -> Iterator[Callable[..., SinkThread]]:
    threads: list[SinkThread] = []

    def start(capacity: int = 4, lossless: bool = False) -> SinkThread:
        thread = SinkThread(notebook, "notebook", capacity, lossless)
        thread.open(None)
        threads.append(thread)
        return thread

    yield start
    notebook.gate.set()
    for thread in threads:
        thread.close(DEADLINE_S)


def chart(*ue: int, x: float = 0.0) -> ChartUpdate:
    k = len(ue)
    floats = [column for column in COLUMNS.values() if column.dtype == "float64"]
    columns = {column.name: np.full(column.shape(k), x) for column in floats}
    method = Method("bartlett", "bartlett")
    return ChartUpdate("lab", method, np.array(ue, np.uint64), np.zeros(k, int), **columns)


def block(frames: int) -> CsiBlock:
    ue = np.zeros(frames, np.uint64)
    return CsiBlock("lab", 0, ue, np.zeros(frames, np.int64), np.zeros((frames, 2, 2), np.complex64))


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        threading.Event().wait(0.005)


def test_waiting_updates_are_handed_over_as_one(
    notebook: Notebook, started: Callable[..., SinkThread]
) -> None:
    thread = started()
    notebook.gate.clear()
    thread.put(chart(1))
    notebook.busy.wait(DEADLINE_S)
    for x in (1.0, 2.0):
        thread.put(chart(1, 2, x=x))
    notebook.gate.set()
    until(lambda: len(notebook.charts) == 2)
    assert notebook.charts[1].ue.tolist() == [1, 2]
    assert notebook.charts[1].x.tolist() == [2.0, 2.0]


def test_a_slow_sink_loses_its_oldest_and_nobody_waits(
    notebook: Notebook, started: Callable[..., SinkThread]
) -> None:
    thread = started(capacity=3)
    notebook.gate.clear()
    thread.put(chart(0))
    notebook.busy.wait(DEADLINE_S)
    for n in range(1, 8):
        thread.put(chart(n))
    assert thread.dropped.as_dict() == {"queue_full": 4}
    notebook.gate.set()
    until(lambda: len(notebook.charts) == 2)
    assert notebook.charts[1].ue.tolist() == [5, 6, 7]


def test_a_lossless_queue_makes_the_reader_wait(
    notebook: Notebook, started: Callable[..., SinkThread]
) -> None:
    thread = started(capacity=2, lossless=True)
    notebook.gate.clear()
    feeder = threading.Thread(target=lambda: [thread.put(block(3)) for _ in range(20)])
    feeder.start()
    notebook.busy.wait(DEADLINE_S)
    notebook.gate.set()
    feeder.join(DEADLINE_S)
    until(lambda: len(notebook.blocks) == 20)
    assert thread.dropped.as_dict() == {}
    assert thread.status()["received"] == 60


def test_a_failing_sink_is_counted_and_goes_on(
    notebook: Notebook, started: Callable[..., SinkThread], caplog: pytest.LogCaptureFixture
) -> None:
    thread = started()
    notebook.failing = OSError(28, "No space left on device")
    thread.put(chart(1, 2))
    until(lambda: thread.errors == 1)
    notebook.failing = None
    thread.put(chart(3))
    until(lambda: len(notebook.charts) == 1)
    assert thread.dropped.as_dict() == {"sink_failed": 2}
    assert "No space left on device" in caplog.text
    assert "Traceback" not in caplog.text


def test_a_failure_to_close_is_counted(notebook: Notebook, caplog: pytest.LogCaptureFixture) -> None:
    thread = SinkThread(notebook, "notebook", 1)
    thread.open(None)
    notebook.failing = RuntimeError("driver is broken")
    thread.close(DEADLINE_S)
    assert thread.status()["errors"] == 1
    assert "driver is broken" in caplog.text
    assert "Traceback" in caplog.text


def test_who_is_patient_waits_for_a_sink_that_gets_on(notebook: Notebook) -> None:
    """One block is let in each time that patience is asked for: all take longer than the time given."""
    thread = SinkThread(notebook, "notebook", 16, lossless=True)
    thread.open(None)
    notebook.gate = turnstile = Turnstile()
    timeout = 2.0
    blocks = int(timeout / ASK_EVERY_S) + 3
    for _ in range(blocks):
        thread.put(block(1))

    def patient() -> bool:
        turnstile.let_in_one()
        return True

    thread.close(timeout, patient)
    assert len(notebook.blocks) == blocks
    assert thread.status()["dropped"] == {}


def test_who_is_patient_does_not_wait_for_one_that_hangs(notebook: Notebook) -> None:
    notebook.gate.clear()
    thread = SinkThread(notebook, "notebook", 8, lossless=True)
    thread.open(None)
    thread.put(block(3))
    thread.close(0.05, lambda: True)
    assert thread.status()["dropped"] == {"not_finished": 3}
    notebook.gate.set()


def test_only_the_latest_report_counts(notebook: Notebook, started: Callable[..., SinkThread]) -> None:
    thread = started()
    notebook.gate.clear()
    thread.put(chart(1))
    notebook.busy.wait(DEADLINE_S)
    for tw in (0.1, 0.2):
        thread.report("quality", {"tw": tw})
    notebook.gate.set()
    until(lambda: bool(notebook.reports))
    assert notebook.reports == [{"tw": 0.2}]


def test_it_ticks_while_nothing_comes(notebook: Notebook, started: Callable[..., SinkThread]) -> None:
    started()
    until(lambda: notebook.ticks >= 2)


def test_closing_hands_over_what_waits(notebook: Notebook) -> None:
    thread = SinkThread(notebook, "notebook", 100)
    thread.open(None)
    for n in range(50):
        thread.put(chart(n))
    thread.close(DEADLINE_S)
    assert sum(len(update) for update in notebook.charts) == 50
    assert notebook.closed


@pytest.mark.parametrize("error", [SetupError("port 5556 is in use"), RuntimeError("driver is broken")])
def test_a_sink_that_cannot_open_says_so(notebook: Notebook, error: Exception) -> None:
    notebook.failing = error
    with pytest.raises(SetupError, match=str(error)):
        SinkThread(notebook, "notebook", 1).open(None)
