"""Chart updates and a node that stands still, for tests of whatever takes charts."""

from __future__ import annotations

from typing import Any

import numpy as np

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.runtime.status import NodeStatus

QUALITY: dict[str, Any] = {"tw": 0.998, "ct": 0.997, "k": 5, "ues": 100, "stress": float("nan")}
STATUS: dict[str, Any] = NodeStatus(
    state="running", array="lab", frames_in=10, frames_estimated=7, dropped={"queue_full": 3}
).as_dict()


def some_chart(
    ues: int = 5, *, first_ue: int = 0, seed: int = 0, position: bool = True, array: str = "lab"
) -> ChartUpdate:
    """UEs numbered from `first_ue`, somewhere; as from a method that gives no standard deviations."""
    rng = np.random.default_rng(seed)
    columns = rng.uniform(0.1, 3, (5, ues))
    known = rng.normal(0, 100, (ues, 3)).astype(np.float32)
    known[ues // 2 :] = np.nan
    return ChartUpdate(
        array,
        Method("bartlett", "isq"),
        ue=np.arange(first_ue, first_ue + ues, dtype=np.uint64),
        time_ns=1_700_000_000_000_000_000 + rng.integers(0, 10**9, ues),
        theta=columns[0],
        rho=100 * columns[1],
        theta_std=np.full(ues, np.nan),
        rho_std=np.full(ues, np.nan),
        x=100 * columns[2],
        y=-100 * columns[3],
        snr=10 * columns[4],
        snapshots=np.full(ues, 16.0),
        position=known if position else None,
    )


class StillNode:
    """What a sink may ask of a node, of a node in which nothing happens."""

    def __init__(self, chart: ChartUpdate | None = None, quality: dict[str, Any] | None = None) -> None:
        self._chart = chart
        self._quality = quality

    def chart(self) -> ChartUpdate | None:
        return self._chart

    def status(self) -> dict[str, Any]:
        return STATUS

    def quality(self) -> dict[str, Any] | None:
        return self._quality

    def request(self, operation: str, arguments: dict[str, Any]) -> dict[str, Any]:
        return {"operation": operation, **arguments}
