"""The dashboard and the systemd unit fit the node."""

from __future__ import annotations

import configparser
import json
import re
from pathlib import Path

from chachart.node.commands.node import _parser
from chachart.node.data.errors import EX_CONFIG
from chachart.node.runtime.latency import Latency
from chachart.node.runtime.status import NodeStatus
from chachart.sinks.web.exposition import exposition

CONFIG = Path(__file__).resolve().parents[2] / "config"


def test_the_dashboard_asks_for_metrics_that_there_are() -> None:
    status = NodeStatus(
        workers=[{"shard": 0, "restarts": 0, "backlog_frames": 0, "backlog_blocks": 0, "ues": 0}],
        latency_histogram=Latency().histogram(),
        quality={"tw": 1.0, "ct": 1.0, "stress": 0.0},
    )
    text = exposition(status.as_dict()).decode()
    there = set(re.findall(r"^# TYPE (\S+)", text, re.MULTILINE))
    dashboard = json.loads((CONFIG / "grafana-dashboard.json").read_text())
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    asked = {name for expression in expressions for name in re.findall(r"\bchachart_\w+", expression)}
    assert {name.removesuffix("_bucket") for name in asked} <= there
    assert len({panel["id"] for panel in dashboard["panels"]}) == len(dashboard["panels"])


def test_a_status_without_anything_has_metrics() -> None:
    assert b"chachart_frames_in_total 0.0" in exposition(NodeStatus().as_dict())
    assert exposition({}) == b""


def test_the_unit_calls_the_node_as_it_wants_to_be_called() -> None:
    unit = configparser.RawConfigParser(strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(CONFIG / "chachart.service")
    service = unit["Service"]
    for key in ("ExecStartPre", "ExecStart"):
        program, *arguments = service[key].split()
        assert program.endswith("/bin/chachart-node")
        assert _parser().parse_args(arguments).config == Path("/etc/chachart/node.toml")
    assert service["RestartPreventExitStatus"] == str(EX_CONFIG)


def test_alerts_are_about_metrics_that_there_are() -> None:
    rules = (CONFIG / "prometheus-rules.yml").read_text()
    report = {"power_db": [0.0], "coherent_db": [0.0], "faults": {"0": "dead"}}
    status = NodeStatus(antennas=report, quality={"tw": 0.9, "ct": 0.9})
    told = exposition(status.as_dict()).decode()
    known = set(re.findall(r"^# TYPE (\S+)", told, re.MULTILINE))
    asked = set(re.findall(r"\b(chachart_\w+)", rules))
    assert len(asked) > 6
    assert asked <= known
