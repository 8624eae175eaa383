from __future__ import annotations

import numpy as np
import pytest

from chachart.node.runtime.latency import Latency


def test_percentiles_are_within_a_bucket() -> None:
    rng = np.random.default_rng(0)
    seconds = 10 ** rng.uniform(-4, 0, 5000)
    latency = Latency()
    for s in seconds:
        latency.add(float(s), 3)
    for percent in (50, 99, 99.9):
        assert latency.percentile(percent) == pytest.approx(np.percentile(seconds, percent), rel=0.07)


def test_nothing_gives_none() -> None:
    assert Latency().percentile(50) is None
    assert Latency().percentiles_ms() == {"p50": None, "p99": None, "p99_9": None}
    assert Latency().histogram()["total"] == 0


def test_extremes_are_kept() -> None:
    latency = Latency()
    latency.add(0.0, 1)
    latency.add(1e6, 1)
    histogram = latency.histogram()
    assert histogram["frames"][0] == 1
    assert histogram["frames"][-1] == 1
    assert histogram["total"] == 2


def test_histogram_is_cumulative() -> None:
    latency = Latency()
    for seconds in (0.0004, 0.003, 0.003, 0.3):
        latency.add(seconds, 10)
    histogram = latency.histogram()
    within = dict(zip(histogram["le_s"], histogram["frames"], strict=True))
    assert within[0.001] == 10
    assert within[0.005] == 30
    assert within[0.5] == histogram["total"] == 40
    assert histogram["sum_s"] == pytest.approx(3.064)
