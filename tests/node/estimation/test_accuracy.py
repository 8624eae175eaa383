"""Estimates and what they say of their accuracy, against the Cramér-Rao bounds; the reference scenario."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation import bounds
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.noise import NoiseFloor
from chachart.node.estimation.quality import assess

Build = Callable[..., Any]
UES = 640


def single_path(
    array: ArrayGeometry, snr_db: float, frames: int, ues: int = UES, **options: Any
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Squared errors over the bound, theta and rho, and the variances of the errors over their stated std."""
    rng = np.random.default_rng(round(snr_db) + 100)
    theta, rho = rng.uniform(np.pi / 6, 5 * np.pi / 6, ues), rng.uniform(150, 900, ues)
    rho *= min(array.unambiguous_rho_m / 1000, 1)
    n, s = np.arange(array.antennas)[:, None], array.tone_numbers
    u = array.theta_phase * array.middle_hz / array.carrier_hz * np.cos(theta)
    v = array.rho_phase * rho
    h = np.exp(1j * (u[:, None, None] * n + v[:, None, None] * s)).astype(np.complex64)
    estimator = ChartEstimator(array, averaging="mean", echoes=False, **options)
    updates = None
    for t in range(frames):
        noise = rng.standard_normal((*h.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
        turn = np.exp(2j * np.pi * rng.random((ues, 1, 1))).astype(np.complex64)
        csi = h * turn + noise * np.float32(10 ** (-snr_db / 20) / 2**0.5)
        csi[:, ~array.live_antennas] = 30
        csi[:, :, ~array.live_tones] = -30j
        updates = estimator.update(CsiBlock("lab", t, np.arange(ues, dtype=np.uint64), np.full(ues, t), csi))
    assert updates is not None
    snr = 10 ** (snr_db / 10)
    theta_error, rho_error = updates.theta - theta, updates.rho - rho
    return (
        np.sqrt(np.mean((theta_error / bounds.theta_std(array, theta, snr, frames)) ** 2)),
        np.sqrt(np.mean((rho_error / bounds.rho_std(array, snr, frames)) ** 2)),
        float(np.mean((theta_error / updates.theta_std) ** 2)),
        float(np.mean((rho_error / updates.rho_std) ** 2)),
    )


@pytest.mark.parametrize("snr_db", [-10.0, 0.0, 20.0])
@pytest.mark.parametrize(
    ("method", "limit"), [("bartlett", 1.05), ("music", 1.05), ("mvdr", 1.15), ("minnorm", 2.6)]
)
def test_reaches_the_stochastic_bound(array: ArrayGeometry, method: str, limit: float, snr_db: float) -> None:
    theta, rho, theta_honest, rho_honest = single_path(array, snr_db, 10, theta=method, rho=method)
    assert theta < limit
    assert rho < limit
    assert 0.8 < theta_honest < 1.25
    assert 0.8 < rho_honest < 1.25


@pytest.mark.parametrize(
    ("options", "ues"),
    [({"signal_order": "mdl"}, 64), ({"forward_backward": True}, UES), ({"signal_order": 3}, UES)],
)
def test_music_keeps_its_accuracy_however_the_order_is_chosen(
    array: ArrayGeometry, options: dict[str, Any], ues: int
) -> None:
    theta, rho, theta_honest, rho_honest = single_path(
        array, 0.0, 5, ues, theta="music", rho="music", **options
    )
    assert max(theta, rho) < 1 + 2.5 / np.sqrt(ues)
    assert max(theta_honest, rho_honest) < 1 + 5 / np.sqrt(ues)


@pytest.mark.parametrize("frames", [1, 2])
def test_mvdr_knows_how_little_few_snapshots_say(array: ArrayGeometry, frames: int) -> None:
    """Its variance is up to twice the bound there; what it states follows."""
    theta, rho, theta_honest, rho_honest = single_path(
        array, 10.0, frames, theta="mvdr", rho="mvdr", loading=0.05
    )
    assert max(theta, rho) > 1.05
    assert 0.8 < theta_honest < 1.25
    assert 0.8 < rho_honest < 1.25


def test_wide_band(array: ArrayGeometry) -> None:
    wide = ArrayGeometry.from_dict(array.as_dict() | {"subcarrier_spacing_hz": 312.5e3})
    theta, rho, _, _ = single_path(wide, 0.0, 4, theta="bartlett", rho="bartlett")
    assert max(theta, rho) < 1.05


INTEL = (*range(-28, 0, 2), -1, *range(1, 28, 2), 28)
"""Tones of a 20 MHz Wi-Fi channel that a well-known tool gives: uneven, with a gap."""
GAPS = (*range(-12, 0), *range(1, 13), *range(20, 28))
FAR_APART = (*range(16), *range(130, 146))


@pytest.mark.parametrize("method", ["bartlett", "mvdr", "minnorm", "music", "joint"])
@pytest.mark.parametrize(
    "changes",
    [
        {"subcarriers": 30, "tones": INTEL},
        {"tones": GAPS, "dead_tones": (3, 4, 31), "dead_antennas": (5, 6, 20)},
        {"tones": tuple(range(-64, 64, 4)), "dead_antennas": (0, 1, 31)},
        {"dead_antennas": tuple(range(1, 32, 2)), "element_spacing_m": 0.0375},
        {"tones": FAR_APART, "subcarrier_spacing_hz": 78_125.0},
    ],
    ids=["Intel", "gaps", "comb", "every other antenna", "two bands"],
)
def test_reaches_the_bound_with_uneven_tones_and_masks(
    array: ArrayGeometry, changes: dict[str, Any], method: str
) -> None:
    """What does not count is rubbish 30 dB above the signal here."""
    if changes.get("tones") == FAR_APART and method in ("joint", "minnorm"):
        return  # side lobes of 95 % of a path's power: joint refuses, and Min-Norm's two vectors do not tell
    uneven = ArrayGeometry.from_dict(array.as_dict() | {"subcarrier_spacing_hz": 312.5e3} | changes)
    limit = {"minnorm": 2.6, "mvdr": 1.2}.get(method, 1.07)
    theta, rho, theta_honest, rho_honest = single_path(
        uneven, 10.0, 4, theta=method, rho=method, phase="random"
    )
    assert max(theta, rho) < limit
    assert 0.75 < theta_honest < 1.3
    assert 0.75 < rho_honest < 1.3


def test_minnorm_excess_is_that_of_an_even_row() -> None:
    """N (N + 1) / (6 (N - 1)), from the two ends of centred places."""
    assert bounds.minnorm_excess(Lattice.even(32)) == pytest.approx(32 * 33 / (6 * 31))


def test_bounds() -> None:
    """The deterministic bound from its own Fisher matrix; the stochastic one lies above it."""
    n, m, snr = 9, 5, 2.0
    k = np.arange(n) - (n - 1) / 2
    information = 2 * m * snr * np.sum(k**2)
    assert bounds.deterministic_std(Lattice.even(n), m, snr) == pytest.approx(1 / np.sqrt(information))
    assert bounds.stochastic_std(Lattice.even(n), m, snr) == pytest.approx(
        bounds.deterministic_std(Lattice.even(n), m, snr) * np.sqrt(1 + 1 / 18)
    )
    assert bounds.mvdr_excess(32, 1e7, 1.0, 0.0) == pytest.approx(1, abs=1e-4)
    assert bounds.mvdr_excess(32, 64, 1e4, 0.0) == pytest.approx(1 / (1 - 31 / 64), rel=0.07)
    assert bounds.mvdr_excess(32, 64, 1.0, 10.0) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(
    ("theta", "rho", "tw", "ct"),
    [
        ("bartlett", "bartlett", 0.9997, 0.9997),
        ("music", "music", 0.9997, 0.9997),
        ("bartlett", "lr", 0.993, 0.996),
        ("bartlett", "isq", 0.988, 0.994),
    ],
)
def test_chart_of_the_reference_scenario(los: Build, theta: str, rho: str, tw: float, ct: float) -> None:
    world = los(2048, 1)
    estimator = ChartEstimator(world.array, theta=theta, rho=rho, averaging="mean")
    quality = assess(world.chart(estimator, 0.0), world.array, None, 4096)
    assert quality["k"] == 102
    assert quality["tw"] >= tw
    assert quality["ct"] >= ct


@pytest.mark.parametrize("amplitude", ["debiased", "coherent", "noisy"])
def test_ranging_by_amplitude(los: Build, truth: Build, amplitude: str) -> None:
    """log(rho) is linear in the log of an amplitude that falls as 1 / rho: LR then finds the range itself."""
    world = los(600)
    options: dict[str, Any] = {"rho": "lr", "lr_log_range": True, "lr_train_ues": 100}
    estimator = ChartEstimator(world.array, amplitude=amplitude, averaging="mean", **options)
    chart = world.chart(estimator, 0.0, phase=False)
    error = chart.rho / truth(world)[1] - 1
    limit = {"debiased": 0.02, "coherent": 0.1, "noisy": 0.3}[amplitude]
    assert np.sqrt(np.mean(error[100:] ** 2)) < limit
    honest = np.mean((error * truth(world)[1] / chart.rho_std) ** 2)
    assert 0.6 < honest < 1.6


def test_isq_is_put_to_scale_by_known_positions_or_a_reference(los: Build, truth: Build) -> None:
    world = los(300)
    chart = world.chart(ChartEstimator(world.array, rho="isq", averaging="mean"), 20.0, 2)
    assert (chart.rho_std > 0).all()
    assert np.mean(chart.rho) == pytest.approx(np.mean(truth(world)[1]), rel=0.1)
    referred = ChartEstimator(world.array, rho="isq", isq_reference=(50.0, 4.0))
    alone = ChartEstimator(world.array, rho="isq")
    block = world.block(60.0, np.arange(3))
    unknown = CsiBlock("lab", 0, block.ue, block.time_ns, block.csi)
    assert referred.update(unknown).rho == pytest.approx(100 * alone.update(unknown).rho)


@pytest.mark.parametrize("snr_db", [-20.0, 0.0, 10.0])
def test_noise_floor_under_several_paths(snr_db: float) -> None:
    rng = np.random.default_rng(5)
    n, m, count = 32, 320, 200
    paths = np.exp(1j * rng.uniform(-np.pi, np.pi, (count, 1, 3)) * np.arange(n)[:, None])
    s = rng.standard_normal((count, 3, m)) + 1j * rng.standard_normal((count, 3, m))
    noise = (rng.standard_normal((count, n, m)) + 1j * rng.standard_normal((count, n, m))) / np.sqrt(2)
    x = np.sqrt(10 ** (snr_db / 10) / 6) * paths @ s + noise
    r = x @ x.conj().swapaxes(1, 2) / m / n
    c = np.stack([np.trace(r, k, 1, 2) * (2 if k else 1) for k in range(n)], axis=1)
    power = NoiseFloor(Lattice.even(n)).power(c, np.full(count, float(m)))
    assert np.mean(power) == pytest.approx(1, abs=0.02)
    assert np.std(power) < 0.03
