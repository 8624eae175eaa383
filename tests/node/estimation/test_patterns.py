"""Elements with patterns of their own: their Fourier series, and directions that take them into account."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chachart.node.data.elements import circle
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry
from chachart.node.data.pattern import Pattern
from chachart.node.estimation import spectra
from chachart.node.estimation.directions.axis import manifold_of
from chachart.node.estimation.directions.sphere import unit
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.subspace import dominant
from chachart.node.files.array_files import read_array_file
from chachart.sources.scenario.los import LosChannel

WAVE_M = SPEED_OF_LIGHT / 3.5e9
AZIMUTH, ELEVATION = np.linspace(-np.pi, np.pi, 73), np.linspace(-np.pi / 2, np.pi / 2, 37)


def outward(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Gains (6, ...) of six elements on a circle, each looking away from the middle, with a phase."""
    turn = (2 * np.pi * np.arange(6) / 6).reshape(-1, *[1] * np.ndim(azimuth))
    ahead = np.cos(azimuth - turn) * np.cos(elevation)
    return (1.2 + ahead + 0.3j * ahead * np.sin(elevation)) * (1 + 0.2 * np.sin(elevation))


def ring(**changes: Any) -> ArrayGeometry:
    pattern = Pattern.of_samples(outward(AZIMUTH[None], ELEVATION[:, None]))
    values = {"position_m": (0.0, 0.0, 9.0), "pattern": pattern, **changes}
    return ArrayGeometry.of_elements("ring", circle(6, 0.6 * WAVE_M), 16, 3.5e9, 781250.0, **values)


def test_the_series_is_the_pattern_between_the_samples_too() -> None:
    rng = np.random.default_rng(0)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, 200), rng.uniform(-1.5, 1.5, 200)
    array = ring()
    assert array.pattern is not None
    found = array.pattern.gains(unit(azimuth, elevation))
    np.testing.assert_allclose(found, outward(azimuth, elevation).T, atol=1e-6)
    assert array.pattern.shape[1] < 10


def test_it_survives_a_recordings_head() -> None:
    array = ring()
    assert ArrayGeometry.from_dict(json.loads(json.dumps(array.as_dict()))) == array


@pytest.mark.parametrize("method", ["bartlett", "mvdr", "music", "minnorm"])
def test_exact_on_an_ideal_covariance(method: str) -> None:
    manifold = manifold_of(ring())
    rng = np.random.default_rng(1)
    d = unit(rng.uniform(-np.pi, np.pi, 60), rng.uniform(-1.1, -0.4, 60))
    a = manifold.steering(d)
    np.testing.assert_allclose(np.linalg.norm(a, axis=1), np.sqrt(6))
    r = 10 * a[:, :, None] * a[:, None].conj() + np.eye(6)
    signal = dominant(r, 1).conj().swapaxes(1, 2)
    x = {
        "bartlett": np.linalg.cholesky(r),
        "mvdr": spectra.mvdr(r, 0.05),
        "music": signal,
        "minnorm": spectra.minnorm(signal, manifold.corners),
    }[method]
    found, _ = manifold.extremum(manifold.features(x, x.conj()), maximum=method in spectra.MAXIMUM, steps=8)
    assert np.linalg.norm(found - d, axis=1).max() < 1e-6


@pytest.mark.parametrize("method", ["music", "joint"])
def test_a_chart_needs_the_patterns(method: Any) -> None:
    array = ring()
    rng = np.random.default_rng(2)
    place = np.stack([rng.uniform(-30, 30, 80), rng.uniform(-30, 30, 80), np.zeros(80)], axis=1)
    csi = LosChannel(array).csi(np.arange(80), place) * 30
    off = {}
    for name, described in (("with", array), ("without", ring(pattern=None))):
        rho: Any = "joint" if method == "joint" else "bartlett"
        chart = ChartEstimator(described, theta=method, rho=rho).update(csi, ue=np.arange(80))
        off[name] = np.median(np.hypot(chart.x - place[:, 0], chart.y - place[:, 1]))
    assert off["with"] < 0.3
    assert off["with"] < off["without"] / 3


def test_what_patterns_forbid_is_said() -> None:
    with pytest.raises(ValueError, match="forward_backward must be off"):
        ChartEstimator(ring(), forward_backward=True)
    with pytest.raises(ValueError, match="pattern is of 6 elements, not 5"):
        ArrayGeometry.of_elements("a", circle(5, 0.1), 4, 2e9, 1e6, pattern=ring().pattern)


@pytest.mark.parametrize("samples", [np.ones((2, 2, 8)), np.ones((2, 5)), np.ones((1, 5, 3))])
def test_what_is_no_pattern_is_refused(samples: np.ndarray) -> None:
    with pytest.raises(ValueError, match="samples must be"):
        Pattern.of_samples(samples)


def test_qdant_files_bring_elements_and_patterns(tmp_path: Path) -> None:
    arrayant = pytest.importorskip("quadriga_lib").arrayant
    gains = np.moveaxis(outward(AZIMUTH[None], ELEVATION[:, None]), 0, 2)
    places = circle(6, 0.1)
    arrayant.qdant_write(
        str(tmp_path / "ring.qdant"),
        {
            "e_theta_re": np.asfortranarray(gains.real),
            "e_theta_im": np.asfortranarray(gains.imag),
            "e_phi_re": np.zeros_like(gains.real, order="F"),
            "e_phi_im": np.zeros_like(gains.real, order="F"),
            "azimuth_grid": AZIMUTH,
            "elevation_grid": ELEVATION,
            "element_pos": np.asfortranarray(places[:, [2, 0, 1]].T),
            "name": "ring",
        },
    )
    found = read_array_file(tmp_path / "ring.qdant", None, None)
    np.testing.assert_allclose(found.elements, places, atol=1e-6)
    assert found.pattern is not None
    d = unit(np.array([0.3, -2.0]), np.array([-0.5, 0.2]))
    np.testing.assert_allclose(found.pattern.gains(d), ring().pattern.gains(d), atol=1e-4)  # type: ignore[union-attr]
    (tmp_path / "no.qdant").write_text("<a/>")
    with pytest.raises(ValueError, match="is no QDANT file"):
        read_array_file(tmp_path / "no.qdant", None, None)
