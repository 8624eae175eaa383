from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from chachart.node.data.chart import ChartUpdate, Method

MakeUpdate = Callable[..., ChartUpdate]


@pytest.fixture
def make_update() -> MakeUpdate:
    """Makes estimates for the given UEs, at their number in metres."""

    def make(ues: list[int], array: str = "lab", time_ns: int = 1_000) -> ChartUpdate:
        n = np.array(ues, np.float64)
        none = np.full(len(n), np.nan)
        return ChartUpdate(
            array,
            Method("bartlett", "music"),
            ue=np.array(ues, np.uint64),
            time_ns=np.full(len(n), time_ns),
            theta=n / 1000,
            rho=n,
            theta_std=none,
            rho_std=none,
            x=n,
            y=-n,
            snr=n / 10,
            snapshots=n + 1,
            position=None,
        )

    return make
