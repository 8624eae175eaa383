from __future__ import annotations

import io
import json
import logging
from typing import Any

import pytest
from rich.console import Console

from chachart.node.estimation.options import Options
from chachart.node.runtime.collector import Collector
from chachart.node.runtime.logs import JsonFormatter
from chachart.node.runtime.panel import counts, line, panel, summary_lines
from chachart.node.runtime.status import NodeStatus, Rates, summary


def status(**changes: Any) -> dict[str, Any]:
    values: dict[str, Any] = {
        "state": "running",
        "array": "lab",
        "source": "simulator",
        "method": {"theta": "bartlett", "rho": "music"},
        "seconds": 12.0,
        "frames_in": 51000,
        "frames_estimated": 50900,
        "frames_in_per_s": 4100.0,
        "frames_estimated_per_s": 4090.0,
        "backlog_frames": 40,
        "dropped": {"queue_full": 60},
        "ues": 2048,
        "latency_ms": {"p50": 5.5, "p99": 9.25, "p99_9": 20.0},
        "quality": {"tw": 0.99981, "ct": 0.99962, "k": 102},
        "workers": [
            {"shard": 0, "pid": 4711, "restarts": 0, "ues": 1000, "backlog_frames": 40},
            {"shard": 1, "pid": None, "restarts": 2, "ues": 0},
        ],
        "sinks": [
            {"name": "publisher", "where": "tcp://127.0.0.1:5556", "dropped": {}, "errors": 0},
            {"name": "chart_log", "where": "chart.mcap", "dropped": {"sink_failed": 7}, "errors": 2},
        ],
    }
    return NodeStatus(**{**values, **changes}).as_dict()


def rendered(values: dict[str, Any], width: int = 110) -> str:
    console = Console(width=width, file=io.StringIO())
    with console.capture() as captured:
        console.print(panel(values, width))
    return captured.get()


def test_the_panel_shows_what_matters() -> None:
    text = rendered(status())
    for wanted in (
        "lab · running · bartlett/music",
        "4,100/s",
        "2,048",
        "60 (queue_full 60)",
        "5.5 ms",
        "0.9998",
        "process 4711",
        "worker 1 restarting",
        "tcp://127.0.0.1:5556",
        "chart.mcap  dropped 7 (sink_failed 7)",
    ):
        assert wanted in text


@pytest.mark.parametrize("width", [40, 60, 80])
def test_a_narrow_panel_clips_no_figure(width: int) -> None:
    text = rendered(status(), width)
    for wanted in (
        "4,100/s",
        "4,090/s",
        "2,048",
        "40 frames",
        "5.5 ms",
        "9.2 ms",
        "51,000",
        "60 (queue_full 60)",
    ):
        assert wanted in text


def test_the_panel_of_a_node_that_knows_nothing_yet() -> None:
    assert "starting" in rendered(NodeStatus(array="lab").as_dict())


def test_the_line() -> None:
    assert line(status()) == (
        "running: 4100 frames/s in, 4090 estimated/s, 2048 UEs, backlog 40, dropped 60 (queue_full 60), "
        "latency p50 5.5 ms p99 9.2 ms, TW 0.9998 CT 0.9996"
    )


def test_the_summary() -> None:
    report = summary(status(), {"p50": 5.5, "p99": None, "p99_9": None})
    assert report["worker_restarts"] == 2
    lines = summary_lines(report)
    assert lines[0] == "frames in 51000, estimated 50900, dropped 60 (queue_full 60), rejected 0"
    assert "p99 –" in lines[1]
    assert lines[2:] == [
        "TW 0.9998 CT 0.9996 (K = 102)",
        "sink chart_log (chart.mcap): dropped 7 (sink_failed 7), 2 errors",
    ]
    assert len(summary_lines(summary(status(quality=None, sinks=[]), {"p50": None, "p99": None}))) == 2


def test_counts_leave_zeros_out() -> None:
    assert counts({"a": 0}) == "0"
    assert counts({"b": 2, "a": 1, "c": 0}) == "3 (a 1, b 2)"


def test_rates() -> None:
    rates = Rates()
    assert rates.add(0.0, 0) == [0.0]
    assert rates.add(1.0, 100) == [100.0]
    for second in range(2, 6):
        latest = rates.add(float(second), 100 + 10 * (second - 1))
    assert latest == [10.0]


def test_charts_without_frames_have_no_latency() -> None:
    charts = Collector(Options())
    charts.tick({})
    assert charts.recent_latency_ms()["p50"] is None


def test_json_log_records(caplog: pytest.LogCaptureFixture) -> None:
    try:
        raise OSError("disk full")
    except OSError:
        logging.getLogger("chachart.x").exception("sink %s", "chart_log")
    record = json.loads(JsonFormatter().format(caplog.records[0]))
    assert record["level"] == "error"
    assert record["message"] == "sink chart_log"
    assert record["time"].endswith("+00:00")
    assert "OSError: disk full" in record["traceback"]
