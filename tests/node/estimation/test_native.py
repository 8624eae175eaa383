"""Kernels in C do what numpy does: matrices of any size, theory's extrema, and whole charts."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chachart.node.data.csi import CsiBlock
from chachart.node.estimation.covariance import covariances
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.lag_sums import LagSums
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.manifold import AngleManifold, Search
from chachart.node.estimation.native import Kernels, in_numpy
from chachart.node.estimation.spectra import inverse_cholesky

Build = Callable[..., Any]

built = pytest.mark.skipif(Kernels.here is None, reason="the kernels are not built, or not for this machine")


def normal(rng: np.random.Generator, *shape: int) -> Any:
    return rng.standard_normal((*shape, 2), np.float32).view(np.complex64)[..., 0]


@pytest.mark.skipif("CHACHART_CI" not in os.environ, reason="they are sure to be built by .ci/run only")
def test_kernels_are_built() -> None:
    flags = Path("/proc/cpuinfo").read_text().split()
    assert Kernels.here is not None or not {"avx2", "fma"} <= set(flags)


@built
@settings(max_examples=80, deadline=None)
@given(
    frames=st.integers(1, 5),
    elements=st.integers(1, 64),
    snapshots=st.integers(1, 70),
    layout=st.sampled_from(["rows", "columns", "every other", "part"]),
    seed=st.integers(0, 2**16),
)
def test_sums_of_products_are_those_of_numpy(
    frames: int, elements: int, snapshots: int, layout: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    x = {
        "rows": lambda: normal(rng, frames, elements, snapshots),
        "columns": lambda: normal(rng, frames, snapshots, elements).swapaxes(1, 2),
        "every other": lambda: normal(rng, frames, 2 * elements, 2 * snapshots)[:, ::2, ::2],
        "part": lambda: normal(rng, frames + 1, elements + 1, snapshots + 1)[1:, 1:, :-1],
    }[layout]()
    exact = x.astype(np.complex128)
    r = exact @ exact.conj().swapaxes(1, 2)
    scale = np.abs(r).max()
    np.testing.assert_allclose(covariances(x), r, atol=2e-6 * scale)
    lags = [np.trace(r, k, 1, 2) * (2 if k else 1) for k in range(elements)]
    lattice = Lattice.even(elements)
    np.testing.assert_allclose(
        LagSums(lattice).of_products(x), np.stack(lags, axis=1), atol=4e-6 * scale * elements
    )
    for one in range(frames):
        assert np.array_equal(covariances(x[one : one + 1])[0], covariances(x)[one])


@built
@settings(max_examples=60, deadline=None)
@given(n=st.integers(1, 64), seed=st.integers(0, 2**16), bad=st.booleans())
def test_inverse_factors_are_inverse_factors(n: int, seed: int, bad: bool) -> None:
    rng = np.random.default_rng(seed)
    x = normal(rng, 3, n, 2 * n + 3)
    r = covariances(x)
    if bad:
        r[1, n // 2, n // 2] = rng.choice([0, -1, np.nan])
    w = inverse_cholesky(r)
    assert np.isnan(w[1]).all() == bad
    whole = [0, 2] if bad else [0, 1, 2]
    assert not np.triu(np.where(np.isnan(w), 0, w), 1).any()
    eye = w[whole] @ r[whole] @ w[whole].conj().swapaxes(1, 2)
    np.testing.assert_allclose(eye, np.broadcast_to(np.eye(n), eye.shape), atol=2e-3)


@built
@pytest.mark.parametrize("maximum", [True, False])
@pytest.mark.parametrize("steps", [1, 8])
def test_extrema_are_those_of_numpy(los: Build, maximum: bool, steps: int) -> None:
    array = los(4, subcarrier_spacing_hz=312.5e3).array
    search = Search(AngleManifold.of(array), None, steps)
    rng = np.random.default_rng(2)
    c = normal(rng, 77, search.manifold.size)
    c[13] = np.nan
    u, value = search.extremum(c, maximum=maximum)
    with in_numpy():
        other_u, other_value = search.extremum(c, maximum=maximum)
    assert np.isnan(value[13])
    good = np.arange(77) != 13
    np.testing.assert_allclose(value[good], other_value[good], rtol=1e-6)
    np.testing.assert_allclose(u[good], other_u[good], atol=1e-6 if steps > 1 else 1e-12)


@built
@pytest.mark.parametrize("method", ["bartlett", "music", "minnorm", "mvdr"])
@pytest.mark.parametrize("snr_db", [0.0, 40.0])
def test_charts_are_those_of_numpy(los: Build, method: str, snr_db: float) -> None:
    world = los(40, subcarrier_spacing_hz=312.5e3)
    block: CsiBlock = world.block(snr_db, np.arange(40).repeat(3))
    here = ChartEstimator(world.array, theta=method, rho=method).update(block)
    with in_numpy():
        there = ChartEstimator(world.array, theta=method, rho=method).update(block)
    for name in ("theta", "rho"):
        off = np.abs(here.columns[name] - there.columns[name]) / there.columns[f"{name}_std"]
        assert off.max() < (0.02 if method in ("music", "minnorm") else 1e-3), name
        np.testing.assert_allclose(here.columns[f"{name}_std"], there.columns[f"{name}_std"], rtol=2e-3)
