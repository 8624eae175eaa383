"""rho = "auto": ranges in bands too narrow for a city's echoes, and what known positions teach."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from directions_samples import an_array, some_frames, somewhere

from chachart.config.settings import ArraySettings
from chachart.node.commands.training.draws import Draw, world
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.directions.sphere import unit
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.snapshots import joined
from chachart.sources.scenario.layout import place

UES, FRAMES, BLOCK = 300, 4, 60


def an_array_of(bandwidth_hz: float) -> ArrayGeometry:
    return ArraySettings(antennas=16, subcarriers=16, subcarrier_spacing_hz=bandwidth_hz / 16).geometry()


def seen(channel: Any, bandwidth_hz: float, seed: int = 77) -> tuple[ArrayGeometry, Any, Any, Any]:
    """The array, noisy frames (U, F, N_R, N_S), true ranges and places of UEs that nothing was fitted to."""
    array = an_array_of(bandwidth_hz)
    csi, _, rho = world(Draw(channel, array, 0.0, FRAMES, UES, seed))
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((UES, FRAMES, 16, 16, 2), np.float32).view(np.complex64)[..., 0]
    return array, csi[:, None] + noise * np.float32(0.5**0.5), rho, place("uniform", UES, array, seed)


def ranged(array: ArrayGeometry, frames: Any, known: Any = None, **options: Any) -> Any:
    """Rows of all UEs in order, a block at a time; `known` (U, 3) are positions or NaN."""
    estimator = ChartEstimator(array, averaging="mean", **{"theta": "bartlett", "rho": "auto", **options})
    charts = []
    for start in range(0, UES, BLOCK):
        ue = np.repeat(np.arange(start, start + BLOCK), FRAMES)
        position = None if known is None else known[ue]
        csi = frames[start : start + BLOCK].reshape(-1, 16, 16)
        charts.append(estimator.update(csi, ue=ue, position=position))
    return {
        name: np.concatenate([c[name] for c in charts]) for name in ("rho", "rho_std", "p_direct", "theta")
    }


@pytest.mark.parametrize(
    ("channel", "bandwidth_hz", "gain"),
    [("qnlos", 312.5e3, 0.6), ("qlos", 312.5e3, 0.95), ("qnlos", 1e6, 0.7)],
)
def test_echoes_are_allowed_for(channel: str, bandwidth_hz: float, gain: float) -> None:
    """Against the better of Bartlett and joint; deviations are true."""
    array, frames, rho, _ = seen(channel, bandwidth_hz)
    found = ranged(array, frames)
    others = [ranged(array, frames, theta=m, rho=m)["rho"] for m in ("bartlett", "joint")]
    median = np.median(np.abs(found["rho"] - rho))
    assert median < gain * min(np.median(np.abs(other - rho)) for other in others)
    assert 0.5 < np.mean(((found["rho"] - rho) / found["rho_std"]) ** 2) < 2
    assert ((found["p_direct"] > 0) & (found["p_direct"] <= 1)).all()


@pytest.mark.parametrize("bandwidth_hz", [312.5e3, 3e6])
def test_loses_nothing_on_a_lone_path(bandwidth_hz: float) -> None:
    array, frames, rho, _ = seen("los", bandwidth_hz)
    found = ranged(array, frames)
    others = [ranged(array, frames, theta=m, rho=m)["rho"] for m in ("bartlett", "joint")]
    best = min(np.median(np.abs(other - rho)) for other in others)
    assert np.median(np.abs(found["rho"] - rho)) < 1.08 * best


def test_known_positions_teach() -> None:
    """A world whose ranges are all a fifth longer than any that the networks have seen would be."""
    array, frames, rho, position = seen("qnlos", 312.5e3)
    late = frames * np.exp(1j * array.rho_phase * 60.0 * array.tone_numbers).astype(np.complex64)
    known = np.where(np.arange(UES)[:, None] < UES // 2, position, np.nan).astype(np.float32)
    after = slice(UES // 2, None)
    off = [np.abs(ranged(array, late, k)["rho"] - rho)[after] for k in (None, known)]
    assert np.median(off[1]) < 0.85 * np.median(off[0])


def test_only_the_latest_of_a_ue_counts_and_snapshots_keep_it() -> None:
    array, frames, _, position = seen("qnlos", 1e6)
    known = position.astype(np.float32)
    one, other = (ChartEstimator(array, theta="music", rho="auto", averaging="mean") for _ in range(2))
    for n in range(FRAMES):
        chart = one.update(frames[:, n], ue=np.arange(UES), position=known)
    law = one.snapshot()["locator.ranging.law"]
    assert law[0] == UES
    assert one.snapshot()["locator.ranging.errors"][1] == UES
    other.restore(joined([one.snapshot()]))
    again = [e.update(frames[:9, 0], ue=np.arange(9)) for e in (one, other)]
    np.testing.assert_allclose(again[0].rho, again[1].rho)
    assert len(chart) == UES


def test_any_array_and_any_theta() -> None:
    array = an_array("2x4", 16)
    rng = np.random.default_rng(1)
    azimuth, elevation = somewhere("2x4", 50, rng)
    d, rho = unit(azimuth, elevation), rng.uniform(20, 200, 50)
    csi = some_frames(array, d, rho, 20.0, rng)
    for theta in ("joint", "music", "none"):
        chart = ChartEstimator(array, theta=theta, rho="auto").update(csi, ue=np.arange(50))
        assert np.median(np.abs(chart.rho - rho)) < 0.5
        if theta != "none":
            assert np.median(np.abs(chart["azimuth"] - azimuth)) < 0.02
    lone = ChartEstimator(array, theta="music", rho="auto", echoes=False).update(csi, ue=np.arange(50))
    plain = ChartEstimator(array, theta="music", rho="bartlett", echoes=False).update(csi, ue=np.arange(50))
    np.testing.assert_array_equal(lone.rho, plain.rho)


def test_what_cannot_be_is_said() -> None:
    with pytest.raises(ValueError, match='rho must not be "auto": it takes at least 4 subcarriers, not 2'):
        ChartEstimator(an_array("2x4", 2), rho="auto")
    with pytest.raises(ValueError, match="packet detection"):
        ChartEstimator(an_array("2x4", 16), rho="auto", delay="relative")
