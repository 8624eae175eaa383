"""Four simulated boards round a hall, over real sockets: one chart, with clocks of their own and with one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from node_runs import DEADLINE_S, until

from chachart.config.load import NodeSettings, load
from chachart.node.runtime.node import Node
from chachart.node.runtime.plan import Plan
from chachart.sources.simulator import Simulator, SimulatorSettings

UES = 8


@pytest.fixture
def hall(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[NodeSettings, Node]]:
    """A shipped configuration with UEs that stand, as a node that runs."""
    count = len(load(Path(request.param)).feeds)
    sources = [f"source.{number}" for number in range(count)] if count > 1 else ["source"]
    changes = [f"{source}.loopback.scenario.motion=static" for source in sources]
    changes += [f"{source}.loopback.scenario.frame_rate_hz=16" for source in sources]
    changes += [
        f"sinks.publisher.endpoint=ipc://{tmp_path}/charts",
        f"sinks.control.endpoint=ipc://{tmp_path}/c",
    ]
    settings = load(Path(request.param), [*changes, "sinks.view.port=0"])
    node = Node(Plan.of(settings))
    node.start()
    yield settings, node
    node.stop(0.1)
    assert node.wait(DEADLINE_S)
    node.close()


def _truth(settings: NodeSettings) -> np.ndarray:
    """Where the simulated UEs stand, (UES, 2)."""
    feed = settings.feeds[0]
    loopback = feed.source.model_dump()["loopback"]
    alike = {**loopback["scenario"], "frame_rate_hz": 0, "in_step": False}
    scenario = SimulatorSettings.model_validate(alike)
    with Simulator(scenario, feed.arrays[0].geometry()) as simulator:
        block = None
        while block is None:
            block = simulator.recv(DEADLINE_S)
    assert block.position is not None
    return block.position[:UES, :2].astype(np.float64)


@pytest.mark.parametrize("hall", ["espargos-hall", "espargos-hall-wired"], indirect=True)
def test_boards_round_a_hall_make_one_chart(hall: tuple[NodeSettings, Node]) -> None:
    settings, node = hall
    truth = _truth(settings)

    def right() -> bool:
        chart = node.chart()
        if chart is None or len(chart) < UES or chart["arrays"].max() < 4:
            return False
        error = np.column_stack([chart.x, chart.y]) - truth[chart.ue.astype(np.int64)]
        return bool((np.hypot(*error.T) < 0.1).all())

    until(right, "all UEs are where they stand")
    assert node.chart().array == "hall"
