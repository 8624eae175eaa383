"""TW and CT against the number of neighbours, for whoever looks at that curve."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import numpy as np

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import RequestError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.quality import neighbourhoods
from chachart.sinks.base import NodeAccess

SHARES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4)
"""Neighbours as shares of the UEs whose position is known."""
MOST_UES = 4096
FRESH_S = 4.0
SEED = 0
"""The same points for every K, so that the curve does not shake."""


def quality_curve(chart: ChartUpdate | None, array: ArrayGeometry) -> dict[str, list[float]]:
    """`k`, `tw` and `ct` as columns, from a random sample of points (and of UEs, if there are very many).

    Raises
    ------
    RequestError
        If too few positions are known.
    """
    position = None if chart is None else chart.position
    if chart is None or position is None:
        raise RequestError("no reference position is known")
    known = np.flatnonzero(np.isfinite(position).all(axis=1) & np.isfinite(chart.x) & np.isfinite(chart.y))
    if len(known) > MOST_UES:
        known = np.random.default_rng(SEED).choice(known, MOST_UES, replace=False)
    truth = np.stack(chart.truth_of(array), axis=1)[known]
    estimate = np.stack([chart.x[known], chart.y[known]], axis=1)
    counts = sorted({k for share in SHARES if 1 <= (k := round(share * len(known))) < len(known) / 2})
    if not counts:
        raise RequestError(f"{len(known)} known positions are too few")
    points = [neighbourhoods(truth, estimate, k, rng=np.random.default_rng(SEED)) for k in counts]
    return {
        "k": [float(k) for k in counts],
        "tw": [point.tw for point in points],
        "ct": [point.ct for point in points],
    }


class CurveKeeper:
    """Works the curve out at most every few seconds, once for everybody who asks."""

    def __init__(self, node: NodeAccess, array: ArrayGeometry) -> None:
        self._node = node
        self._array = array
        self._task: asyncio.Task[dict[str, Any]] | None = None
        self._made = 0.0

    async def get(self) -> dict[str, Any]:
        """The curve.

        Raises
        ------
        RequestError
            If too few positions are known.
        """
        if self._task is None or (self._task.done() and time.monotonic() - self._made > FRESH_S):
            self._made = time.monotonic()
            self._task = asyncio.create_task(asyncio.to_thread(self._make))
        return await asyncio.shield(self._task)

    def _make(self) -> dict[str, Any]:
        return dict(quality_curve(self._node.chart(), self._array))
