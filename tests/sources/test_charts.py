from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from source_contract import SourceCase, SourceContract, receive

from chachart.config.settings import ArraySettings
from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.csi import CsiBlock
from chachart.node.data.methods import FUSION
from chachart.node.estimation.estimator import ChartEstimator
from chachart.sinks.publisher import Publisher, PublisherSettings
from chachart.sources.base import Source
from chachart.sources.charts import Charts, ChartsSettings, Waves

LINE = ArraySettings(name="lab", antennas=16, subcarriers=16, subcarrier_spacing_hz=1e6).geometry()
BOARD = ArraySettings(
    name="lab", rows=4, columns=4, subcarriers=16, subcarrier_spacing_hz=1e6, axis="y", broadside="x"
).geometry()


def rows(count: int = 3, **columns: Any) -> ChartUpdate:
    """Rows of a chart of UEs in different directions."""
    n = np.arange(count)
    values: dict[str, Any] = {
        "theta": np.linspace(0.8, 2.2, count),
        "rho": np.linspace(60.0, 110.0, count),
        "theta_std": np.full(count, 0.01),
        "rho_std": np.full(count, 1.0),
        "azimuth": np.linspace(-0.6, 0.7, count),
        "elevation": np.linspace(-0.3, 0.1, count),
        "azimuth_std": np.full(count, 0.01),
        "x": np.zeros(count),
        "y": np.zeros(count),
        "snr": np.full(count, 10.0),
        "snapshots": np.ones(count),
    }
    times = np.full(count, time.time_ns())
    return ChartUpdate("lab", Method("joint", "joint"), n.astype(np.uint64), times, **(values | columns))


@pytest.fixture
def publisher(tmp_path: Path) -> Iterator[Publisher]:
    sink = Publisher(PublisherSettings(endpoint=f"ipc://{tmp_path}/charts"), LINE)
    sink.open(None)
    yield sink
    sink.close()


class TestContract(SourceContract):
    @pytest.fixture
    def case(self, publisher: Publisher, tmp_path: Path) -> SourceCase:
        def feed(source: Source) -> None:
            publisher.on_tick()
            publisher.on_chart(rows())

        return SourceCase("charts", {"endpoint": f"ipc://{tmp_path}/charts"}, LINE, feed)


@pytest.mark.parametrize("array", [LINE, BOARD], ids=["line", "board"])
def test_frames_say_what_the_rows_said(array: Any) -> None:
    update = rows(5)
    csi = Waves(array, ranges=True).frames(update)
    block = CsiBlock.of(csi, update.ue, update.time_ns)
    found = ChartEstimator(array, theta="joint", rho="joint").update(block)
    np.testing.assert_allclose(found.rho, update.rho, atol=3.0)
    if array.is_line:
        np.testing.assert_allclose(found.theta, update.theta, atol=0.02)
    else:
        np.testing.assert_allclose(found["azimuth"], update["azimuth"], atol=0.03)
        np.testing.assert_allclose(found["elevation"], update["elevation"], atol=0.05)


def test_rows_that_are_less_sure_become_frames_with_more_noise() -> None:
    shares = []
    for std in (0.001, 0.02, 0.2):
        update = rows(200, theta_std=np.full(200, std), rho_std=np.zeros(200))
        csi = Waves(LINE, ranges=True).frames(update)
        pure = Waves(LINE, ranges=True)
        pure._noise_power = lambda _: np.zeros(200)  # type: ignore[method-assign]
        wave = pure.frames(update)
        noise = np.abs(csi - wave) ** 2
        shares.append(float((noise / np.abs(wave) ** 2).mean()))
    assert shares == sorted(shares)
    assert shares[0] == pytest.approx(1e-3, rel=0.1)
    assert shares[2] == pytest.approx(1.0, rel=0.1)


def test_what_has_no_direction_or_is_fused_is_counted(publisher: Publisher, tmp_path: Path) -> None:
    settings = ChartsSettings(endpoint=f"ipc://{tmp_path}/charts")
    fused = rows()
    fused.method = Method(FUSION, FUSION)
    without = rows(rho=np.array([np.nan, 5.0, 6.0]))
    with Charts(settings, LINE) as source:

        def feed() -> None:
            publisher.on_tick()
            publisher.on_chart(fused)
            publisher.on_chart(without)

        blocks = receive(source, 2, feed)
        assert [len(block) for block in blocks] == [2]
        rejected = source.rejected.as_dict()
        assert rejected["no_direction"] >= 1
        assert rejected["fused"] >= 3
        assert "fused already" in str(source.complaint)


def test_an_endpoint_that_is_none_is_told(tmp_path: Path) -> None:
    assert "no endpoint" in Charts.problems(ChartsSettings(endpoint="nowhere"))[0]
    told = ChartsSettings(key=tmp_path / "me.key_secret", server_key=tmp_path / "node.key")
    assert str(tmp_path) in Charts.problems(told)[0]
