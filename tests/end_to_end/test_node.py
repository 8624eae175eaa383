"""The node's main loop inside this process, its children as processes of their own."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import odd_sources
import pytest
from node_runs import ARRAY, DEADLINE_S, adds_up, capture_blocks, children, until

from chachart.config.settings import QualitySettings, StateSettings, WorkersSettings
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import RequestError, SetupError
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.options import Options
from chachart.node.files.recording import RecordingReader
from chachart.node.runtime import requests
from chachart.node.runtime.node import Node
from chachart.node.runtime.plan import Plan
from chachart.sources.recording import Recording, RecordingSettings

MakeNode = Callable[..., Node]


@pytest.fixture
def make_node(capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MakeNode]:
    """Nodes on the capture or, with `odd`, on a source that misbehaves; what still runs is killed."""
    monkeypatch.setenv("PYTHONPATH", str(Path(odd_sources.__file__).parent))
    nodes = []

    def make(
        odd: str | None = None,
        loops: int = 1,
        estimator: dict[str, Any] | None = None,
        state: dict[str, Any] | None = None,
        **workers: Any,
    ) -> Node:
        source: Any = (Recording, RecordingSettings(path=capture, speed=0, loops=loops))
        if odd is not None:
            source = (odd_sources.Odd, odd_sources.OddSettings.model_validate({"type": "odd", "odd": odd}))
        node = Node(
            Plan(
                ARRAY,
                *source,
                Options(**{"averaging": "mean", **(estimator or {})}),
                WorkersSettings(**workers),
                QualitySettings(every_s=0.2, k=5),
                StateSettings(**(state or {})),
                (),
            )
        )
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        if not node.closed:
            node.stop(0.1)
            node.close()


def run(node: Node) -> dict[str, Any]:
    node.start()
    assert node.wait(DEADLINE_S)
    return node.close()


@pytest.mark.parametrize("workers", [1, 2])
def test_replay_estimates_every_frame_as_the_library_does(make_node: MakeNode, workers: int) -> None:
    node = make_node(count=workers, block_frames=16)
    summary = run(node)
    frames = CsiBlock.concatenate(capture_blocks())
    assert summary["frames_in"] == summary["frames_estimated"] == len(frames)
    assert summary["dropped"] == summary["rejected"] == {}
    assert (summary["gaps"], summary["out_of_order"]) == (0, 0)
    expected = ChartEstimator(ARRAY, averaging="mean").update(frames)
    chart = node.chart()
    assert chart is not None
    chart, expected = chart.take(np.argsort(chart.ue)), expected.take(np.argsort(expected.ue))
    np.testing.assert_array_equal(chart.ue, expected.ue)
    np.testing.assert_allclose(chart.theta, expected.theta, atol=1e-4)
    np.testing.assert_allclose(chart.rho, expected.rho, rtol=1e-3)
    np.testing.assert_array_equal(chart.snapshots, expected.snapshots)
    assert summary["quality"]["tw"] > 0.9
    assert summary["latency_ms"]["p99"] > 0


def test_kill_9_under_load_loses_nothing_of_a_recording(
    make_node: MakeNode, caplog: pytest.LogCaptureFixture
) -> None:
    node = make_node(loops=0, count=2, block_frames=16)
    node.start()
    for kill in range(2):
        until(lambda: all(w["pid"] and w["backlog_frames"] for w in node.status()["workers"]), "both work")
        os.kill(node.status()["workers"][kill]["pid"], signal.SIGKILL)
        restarts = kill + 1
        until(lambda n=restarts: sum(w["restarts"] for w in node.status()["workers"]) == n, "restart")
        before = node.status()["workers"][kill]["frames_estimated"]
        until(
            lambda k=kill, b=before: node.status()["workers"][k]["frames_estimated"] > b + 1000,
            "the successor works",
        )
    node.stop()
    assert node.wait(DEADLINE_S)
    summary = node.close()
    assert summary["frames_in"] == summary["frames_estimated"] > 2000
    assert summary["dropped"] == {}
    assert summary["worker_restarts"] == 2
    assert "worker 0 (process" in caplog.text
    assert "killed by SIGKILL" in caplog.text


def test_what_a_drain_does_not_finish_in_time_is_counted(make_node: MakeNode) -> None:
    node = make_node(loops=0, block_frames=16)
    node.start()
    until(lambda: node.status()["workers"][0]["pid"] and node.status()["frames_estimated"], "it works")
    os.kill(node.status()["workers"][0]["pid"], signal.SIGSTOP)
    until(lambda: node.status()["backlog_frames"], "frames wait")
    node.stop(0.2)
    assert node.wait(DEADLINE_S)
    summary = node.close()
    assert summary["dropped"]["drain_deadline"] > 0
    assert adds_up(summary)


@pytest.mark.parametrize(("odd", "message"), [("open", "not plugged in"), ("crash", "feeder process died")])
def test_a_source_that_cannot_open_ends_the_start(make_node: MakeNode, odd: str, message: str) -> None:
    node = make_node(odd)
    with pytest.raises(SetupError, match=message):
        node.start()


def test_a_source_that_fails_ends_the_node_and_counts_add_up(make_node: MakeNode) -> None:
    node = make_node("recv")
    summary = run(node)
    assert node.failure is not None
    assert "unplugged" in node.failure
    assert summary["frames_in"] == summary["frames_estimated"] == odd_sources.FRAMES * odd_sources.BLOCKS // 2


def test_odd_frames_are_rejected_and_odd_numbers_counted(make_node: MakeNode) -> None:
    summary = run(make_node("frames"))
    assert summary["rejected"] == {"shape": odd_sources.FRAMES}
    assert summary["frames_in"] == odd_sources.FRAMES * (odd_sources.BLOCKS - 1)
    assert (summary["gaps"], summary["out_of_order"]) == (2 * odd_sources.FRAMES, odd_sources.FRAMES)
    assert adds_up(summary)


def test_a_dead_quality_process_is_replaced(make_node: MakeNode, caplog: pytest.LogCaptureFixture) -> None:
    node = make_node(loops=0)
    node.start()
    until(lambda: node.quality(), "there is a quality report")
    [process] = children(os.getpid(), "quality")
    os.kill(process, signal.SIGKILL)
    until(lambda: "quality process died" in caplog.text, "it is noticed")
    until(lambda: children(os.getpid(), "quality") not in ([], [process]), "another one starts")
    node.stop()
    assert node.wait(DEADLINE_S)
    assert node.close()["quality"]["tw"] > 0.9


def test_a_source_whose_details_are_odd_costs_only_them(make_node: MakeNode) -> None:
    node = make_node("details")
    summary = run(node)
    assert node.failure is None
    assert summary["frames_in"] == summary["frames_estimated"] == odd_sources.FRAMES * odd_sources.BLOCKS
    assert node.status()["source_details"] == {"error": "LookupError: a bug"}


def test_sockets_find_a_place_where_tmpdir_is_too_long(
    make_node: MakeNode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    long = tmp_path / ("long" * 20)
    long.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(long))
    assert run(make_node())["frames_estimated"] == 1000


def test_a_quality_process_that_dies_three_times_in_a_minute_ends_the_node(make_node: MakeNode) -> None:
    node = make_node(loops=0)
    node.start()
    killed: list[int] = []
    for _ in range(3):
        until(lambda: set(children(os.getpid(), "quality")) - set(killed), "there is one")
        [process] = set(children(os.getpid(), "quality")) - set(killed)
        killed.append(process)
        os.kill(process, signal.SIGKILL)
    assert node.wait(DEADLINE_S)
    assert node.failure == "the quality process died 3 times within a minute"
    assert adds_up(node.close())


def test_a_feeder_that_dies_three_times_in_a_minute_ends_the_node(make_node: MakeNode) -> None:
    node = make_node(loops=0)
    node.start()
    for restarts in range(3):
        until(lambda n=restarts: node.status()["feeder_restarts"] == n, "the feeder is there again")
        before = node.status()["frames_estimated"]
        until(lambda b=before: node.status()["frames_estimated"] > b, "frames are estimated")
        os.kill(node.feeder_pid, signal.SIGKILL)
    assert node.wait(DEADLINE_S)
    assert node.failure is not None
    assert "feeder process died 3 times" in node.failure
    assert adds_up(node.close())


def test_at_most_max_ues_stay_on_the_chart(make_node: MakeNode) -> None:
    summary = run(make_node(estimator={"max_ues": 7}))
    assert summary["ues"] == 7
    assert summary["ues_evicted"] > 0
    assert summary["frames_in"] == summary["frames_estimated"]


def test_requests_while_it_runs(make_node: MakeNode, tmp_path: Path) -> None:
    node = make_node(loops=0, count=2)
    node.start()
    until(lambda: node.status()["ues"] == 40, "all UEs are on the chart")
    assert node.status()["state"] == "running"
    assert sorted(row["ue"] for row in node.ues()["ues"]) == list(range(40))
    assert len(node.chart_columns()["theta"]) == 40
    for ue in range(4):
        assert len(node.spectrum(ue)["theta_spectrum"]) > 0
    assert node.set_method("music", "isq") == {"theta": "music", "rho": "isq"}
    assert node.status()["method"] == {"theta": "music", "rho": "isq"}
    until(lambda: _methods(node) == ("music", "isq"), "the new methods are in use")
    until(lambda: node.status()["workers"][0]["pid"], "worker 0 is there")
    os.kill(node.status()["workers"][0]["pid"], signal.SIGKILL)
    until(lambda: node.status()["workers"][0]["restarts"] == 1, "restart")
    until(lambda: node.status()["workers"][0]["ues"] > 0, "the successor works")
    node.stop()
    assert node.wait(DEADLINE_S)
    assert _methods(node) == ("music", "isq")
    summary = node.close()
    assert summary["frames_in"] == summary["frames_estimated"]


def test_a_recording_is_started_and_stopped_by_request(make_node: MakeNode, tmp_path: Path) -> None:
    node = make_node(loops=0)
    node.start()
    path = tmp_path / "by-request.mcap"
    assert node.start_recording(path, "zstd")["on"]
    with pytest.raises(RequestError, match="already recording"):
        node.start_recording(path)
    until(lambda: (node.status()["recording"] or "").startswith(str(tmp_path)), "status tells")
    frames = node.status()["frames_in"]
    until(lambda: node.status()["frames_in"] > frames + 500, "frames are recorded")
    answer = node.stop_recording()
    assert (answer["on"], answer["dropped"]) == (False, {})
    with pytest.raises(RequestError, match="no recording"):
        node.stop_recording()
    node.stop()
    assert node.wait(DEADLINE_S)
    node.close()
    recorded = [RecordingReader(file).summary() for file in tmp_path.glob("by-request*.mcap")]
    assert sum(summary.frames for summary in recorded) == answer["received"]


BAD_REQUESTS: list[tuple[Callable[[Node], Any], str]] = [
    (lambda node: node.spectrum(2**63), "is not on the chart"),
    (lambda node: node.set_method("bartlet", "bartlett"), "theta = 'bartlet'"),
    (lambda node: node.set_method("joint", "bartlett"), "joint"),
    (lambda node: node.start_recording(Path("/nowhere/at/all.mcap")), "/nowhere/at"),
    (lambda node: node.stop_recording(), "no recording"),
]


def test_bad_requests_get_an_error_and_change_nothing(make_node: MakeNode) -> None:
    node = make_node(loops=0)
    node.start()
    until(lambda: node.status()["ues"] == 40, "all UEs are on the chart")
    for ask, message in BAD_REQUESTS:
        with pytest.raises(RequestError, match=message):
            ask(node)
    node.stop()
    assert node.wait(DEADLINE_S)
    assert _methods(node) == ("bartlett", "bartlett")
    summary = node.close()
    assert summary["frames_in"] == summary["frames_estimated"]


def test_a_method_that_is_answered_late_is_what_status_says(
    make_node: MakeNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make_node(loops=0)
    node.start()
    until(lambda: node.status()["ues"] == 40, "all UEs are on the chart")
    monkeypatch.setattr(requests, "TIMEOUT_S", 0.2)
    assert node.feeder_pid is not None
    os.kill(node.feeder_pid, signal.SIGSTOP)
    with pytest.raises(RequestError, match="not answered within"):
        node.set_method("music", "isq")
    assert node.status()["method"] == {"theta": "bartlett", "rho": "bartlett"}
    os.kill(node.feeder_pid, signal.SIGCONT)
    until(lambda: node.status()["method"] == {"theta": "music", "rho": "isq"}, "status tells the truth")
    until(lambda: _methods(node) == ("music", "isq"), "the new methods are in use")


def _methods(node: Node) -> tuple[str, str] | None:
    chart = node.chart()
    return None if chart is None else (chart.method.theta, chart.method.rho)
