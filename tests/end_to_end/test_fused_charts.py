"""Nodes that chart, and one that fuses what they say, over TCP with keys."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_runs import DEADLINE_S, until

from chachart.config.load import settings_of
from chachart.node.commands.main import main
from chachart.node.runtime.node import Node
from chachart.node.runtime.plan import Plan

Start = Callable[..., Node]
UES = 6
BOARDS = {
    "south": {"position_m": [20.0, 0.0, 4.0], "axis": "-x", "broadside": "y"},
    "west": {"position_m": [0.0, 15.0, 4.0], "axis": "y", "broadside": "x"},
}
SIMULATOR = {
    "type": "simulator",
    "layout": "uniform",
    "ues": UES,
    "frame_rate_hz": 60.0,
    "snr_db": 10.0,
    "area_m": [5.0, 35.0, 5.0, 25.0],
    "area_in": "world",
    "in_step": True,
    "ue_height_m": 1.5,
}


def _array(name: str) -> dict[str, Any]:
    return {
        "name": name,
        "rows": 4,
        "columns": 4,
        "subcarriers": 16,
        "subcarrier_spacing_hz": 1.25e6,
        "clock": "hall",
        **BOARDS[name],
    }


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts nodes; what still runs is ended."""
    nodes: list[Node] = []

    def begin(document: dict[str, Any]) -> Node:
        nodes.append(Node(Plan.of(settings_of(document, [], "test"))))
        nodes[-1].start()
        return nodes[-1]

    yield begin
    for node in nodes:
        node.stop(0.1)
        assert node.wait(DEADLINE_S)
        node.close()


def test_what_two_nodes_say_becomes_one_chart(start: Start, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    assert main(["keys", "new", "node", "--folder", str(keys)]) == 0
    assert main(["keys", "new", "fuser", "--folder", str(tmp_path / "mine")]) == 0
    allow = ["keys", "allow", str(tmp_path / "mine" / "fuser.key"), "--may", "read", "--folder", str(keys)]
    assert main(allow) == 0
    sources, nodes = [], []
    for name in BOARDS:
        node = start(
            {
                "array": _array(name),
                "source": SIMULATOR,
                "estimator": {"theta": "joint", "rho": "joint", "memory_frames": 1, "path_list": True},
                "security": {"keys": str(keys)},
                "sinks": [{"type": "publisher", "endpoint": "tcp://127.0.0.1:0"}],
            }
        )
        nodes.append(node)
        sources.append(
            {
                "type": "charts",
                "array": name,
                "endpoint": dict(node.addresses())["publisher"],
                "key": str(tmp_path / "mine" / "fuser.key_secret"),
                "server_key": str(keys / "node.key"),
            }
        )
    fusing = start(
        {
            "array": [_array(name) for name in BOARDS],
            "source": sources,
            "fusion": {"area_m": [0.0, 0.0, 40.0, 30.0], "height_m": 1.5, "window_ms": 50},
            "tracking": {"motion": "walk"},
        }
    )

    def right() -> bool:
        chart = fusing.chart()
        if chart is None or len(chart) < UES or chart["arrays"].max() < 2:
            return False
        error = np.hypot(chart.x - chart["position"][:, 0], chart.y - chart["position"][:, 1])
        return bool((error < 1.0).all())

    until(right, "all UEs are where they stand")
    told = nodes[0].chart()
    assert told is not None
    assert np.isfinite(told["paths"]).all()
    until(lambda: {one["name"] for one in fusing.status()["arrays"]} == set(BOARDS), "both are told of")
