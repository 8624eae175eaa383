"""The four methods against theory: exact on ideal covariances, on both manifolds."""

from collections.abc import Callable

import numpy as np
import pytest

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation import order, spectra
from chachart.node.estimation.covariance import forward_backward
from chachart.node.estimation.lag_sums import LagSums
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.manifold import (
    AngleManifold,
    DelayManifold,
    Search,
    UniformManifold,
    derivatives,
    polynomial_table,
    powers,
)
from chachart.node.estimation.subspace import SubspaceTracker, dominant


def lags(factor: np.ndarray) -> np.ndarray:
    return LagSums(Lattice.even(factor.shape[1])).of_products(factor)


def music(r: np.ndarray, sources: int) -> np.ndarray:
    return dominant(r, sources).conj().swapaxes(1, 2)


METHODS: dict[str, Callable[[np.ndarray, int], np.ndarray]] = {
    "bartlett": lambda r, sources: np.linalg.cholesky(r),
    "mvdr": lambda r, sources: spectra.mvdr(r, 0.05),
    "minnorm": lambda r, sources: spectra.minnorm(music(r, sources)),
    "music": music,
}


def ideal(manifold: UniformManifold, u: np.ndarray, snr: float = 1.0) -> np.ndarray:
    """Covariances of one path at each u, in white noise of power 1."""
    a = manifold.steering(u)
    return snr * a[:, :, None] * a[:, None, :].conj() + np.eye(manifold.size)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("snr", [0.1, 1.0, 1e4])
@pytest.mark.parametrize("size", [4, 13, 32, 66])
def test_exact_angle_on_an_ideal_covariance(array: ArrayGeometry, method: str, snr: float, size: int) -> None:
    shape = array.as_dict() | {"antennas": size}
    manifold = AngleManifold.of(ArrayGeometry.from_dict(shape))
    theta = np.random.default_rng(1).uniform(0.15, np.pi - 0.15, 40)
    c = lags(METHODS[method](ideal(manifold, manifold.u(theta), snr), 1))
    u, _ = Search(manifold, None, 4).extremum(c, maximum=method in spectra.MAXIMUM)
    assert np.abs(manifold.coordinate(u) - theta).max() < 1e-6


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("spacing_hz", [9765.625, 312.5e3])
@pytest.mark.parametrize("rho_max_m", [900.0, 1e5])
def test_exact_range_on_an_ideal_covariance(
    array: ArrayGeometry, method: str, spacing_hz: float, rho_max_m: float
) -> None:
    shape = array.as_dict() | {"subcarrier_spacing_hz": spacing_hz}
    manifold = DelayManifold.of(ArrayGeometry.from_dict(shape), rho_max_m)
    far = manifold.coordinate(np.array([manifold.low]))[0]
    rho = np.concatenate(
        [np.random.default_rng(1).uniform(0, far, 100), [0.0, 0.5, 1e-3 * far, 0.999 * far, far]]
    )
    c = lags(METHODS[method](ideal(manifold, manifold.u(rho)), 1))
    u, _ = Search(manifold, None, 4).extremum(c, maximum=method in spectra.MAXIMUM)
    apart = np.abs(u - manifold.u(rho))
    assert np.minimum(apart, 2 * np.pi - apart).max() < 1e-6
    if spacing_hz < 1e5 and rho_max_m < 1e4:
        assert np.abs(manifold.coordinate(u) - rho).max() < 1e-2


@pytest.mark.parametrize("method", ["mvdr", "minnorm", "music"])
def test_methods_that_resolve_tell_two_paths_apart(array: ArrayGeometry, method: str) -> None:
    manifold = AngleManifold.of(array)
    a = manifold.steering(np.array([0.5, 0.5 + 1.6 * 2 * np.pi / 32]))
    r = 100 * (a.T @ a.conj())[None] + np.eye(32)
    values = Search(manifold, 0.002, 0).spectrum(lags(METHODS[method](r, 2)))[0]
    values = -values if method in spectra.MAXIMUM else values
    grid = Search(manifold, 0.002, 0).grid
    dips = np.flatnonzero((values[1:-1] < values[:-2]) & (values[1:-1] < values[2:])) + 1
    deepest = np.sort(grid[dips[np.argsort(values[dips])[:2]]])
    assert deepest == pytest.approx([0.5, 0.5 + 1.6 * 2 * np.pi / 32], abs=0.01)


@pytest.mark.parametrize("size", [3, 8, 21, 32])
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_inverse_cholesky(size: int, dtype: type) -> None:
    rng = np.random.default_rng(0)
    x = rng.standard_normal((5, size, 2 * size)) + 1j * rng.standard_normal((5, size, 2 * size))
    r = (x @ x.conj().swapaxes(1, 2)).astype(dtype)
    inverse = spectra.inverse_cholesky(r)
    assert inverse.dtype == dtype
    assert np.allclose(
        inverse @ np.linalg.cholesky(r), np.eye(size), atol=1e-4 if dtype == np.complex64 else 1e-12
    )


@pytest.mark.parametrize("size", [2, 7, 32, 65, 100])
@pytest.mark.parametrize("columns", [1, 5, 40])
def test_lag_sums_give_the_quadratic_form(size: int, columns: int) -> None:
    rng = np.random.default_rng(size)
    x = rng.standard_normal((3, size, columns)) + 1j * rng.standard_normal((3, size, columns))
    manifold = AngleManifold(Lattice.even(size), -np.pi, np.pi, np.pi)
    u = rng.uniform(-np.pi, np.pi, 3)
    a = manifold.steering(u)
    q = x @ x.conj().swapaxes(1, 2)
    expected = np.einsum("kn,knm,km->k", a.conj(), q, a).real
    c = lags(x)
    value = derivatives(np.ascontiguousarray(c.T), u, Lattice.even(size))[0]
    assert value == pytest.approx(expected, rel=1e-10)
    assert LagSums(Lattice.even(size)).of(q) == pytest.approx(c, rel=1e-9, abs=1e-9)
    table = polynomial_table(u, np.arange(size))
    assert np.diag(c.view(float) @ table) == pytest.approx(expected, rel=1e-10)


def test_derivatives_against_differences() -> None:
    rng = np.random.default_rng(2)
    c = rng.standard_normal((20, 6)) + 1j * rng.standard_normal((20, 6))
    u, h = rng.uniform(-3, 3, 6), 1e-5
    _, slope, curvature = derivatives(c, u, Lattice.even(len(c)))
    after, before = derivatives(c, u + h, Lattice.even(len(c))), derivatives(c, u - h, Lattice.even(len(c)))
    assert slope == pytest.approx((after[0] - before[0]) / (2 * h), rel=1e-5, abs=1e-5)
    assert curvature == pytest.approx((after[1] - before[1]) / (2 * h), rel=1e-5, abs=1e-4)
    assert powers(u, 20) == pytest.approx(np.exp(1j * np.outer(np.arange(20), u)), abs=1e-13)


def test_search_stays_in_range_when_the_peak_lies_beyond(array: ArrayGeometry) -> None:
    near = DelayManifold.of(array, 300.0)
    c = lags(np.linalg.cholesky(ideal(near, near.u(np.array([-40.0, 500.0])))))
    u, _ = Search(near, None, 20).extremum(c, maximum=True)
    assert near.coordinate(u) == pytest.approx([0, 300], abs=1e-6)


def test_newton_steps_0_keeps_the_grid(array: ArrayGeometry) -> None:
    manifold = AngleManifold.of(array)
    search = Search(manifold, np.radians(1.0), 0)
    theta = np.radians([20.3, 89.6, 150.0])
    u, _ = search.extremum(lags(np.linalg.cholesky(ideal(manifold, manifold.u(theta)))), maximum=True)
    assert np.degrees(manifold.coordinate(u)) == pytest.approx([20, 90, 150], abs=1e-6)


def test_wide_element_spacing_searches_the_unambiguous_part_only(array: ArrayGeometry) -> None:
    wide = ArrayGeometry.from_dict(array.as_dict() | {"element_spacing_m": 0.15})
    manifold = AngleManifold.of(wide)
    assert (manifold.low, manifold.high) == (-np.pi, np.pi)
    assert manifold.phase > 6


def test_angles_are_read_at_the_middle_of_the_band(array: ArrayGeometry) -> None:
    wide = ArrayGeometry.from_dict(array.as_dict() | {"subcarrier_spacing_hz": 1e6})
    assert AngleManifold.of(wide).phase == pytest.approx(np.pi * (2e9 + 15.5e6) / 2e9)


def test_forward_backward_is_centro_hermitian() -> None:
    rng = np.random.default_rng(0)
    x = rng.standard_normal((2, 6, 9)) + 1j * rng.standard_normal((2, 6, 9))
    r = forward_backward(x @ x.conj().swapaxes(1, 2))
    assert r == pytest.approx(r[:, ::-1, ::-1].conj())
    assert r == pytest.approx(r.conj().swapaxes(1, 2))
    assert lags(x) == pytest.approx(LagSums(Lattice.even(6)).of(r))


def sample(eigenvalues: list[float], snapshots: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    shape = (count, len(eigenvalues), snapshots)
    x = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    x *= np.sqrt(np.array(eigenvalues))[:, None]
    return x @ x.conj().swapaxes(1, 2) / snapshots


@pytest.mark.parametrize("sources", [1, 2, 3])
@pytest.mark.parametrize("snapshots", [40, 320])
def test_mdl_counts_the_sources(sources: int, snapshots: int) -> None:
    r = sample([30.0] * sources + [1.0] * (16 - sources), snapshots, 200)
    assert (order.mdl(np.linalg.eigvalsh(r), np.full(200, snapshots)) == sources).mean() > 0.97


def test_mdl_with_fewer_snapshots_than_elements() -> None:
    r = sample([1000.0, 1000.0] + [1.0] * 30, 12, 100)
    assert (order.mdl(np.linalg.eigvalsh(r), np.full(100, 12)) == 2).mean() > 0.5


def test_threshold_counts_large_eigenvalues() -> None:
    values = np.array([[1.0, 2, 30, 100], [1, 1, 1, 100], [50, 50, 60, 100]])
    assert order.threshold(values, 0.2).tolist() == [2, 1, 3]


def test_leading_vectors_are_zero_beyond_the_order() -> None:
    vectors = np.linalg.eigh(sample([9, 5, 1, 1], 50, 2))[1]
    signal = order.leading(vectors, np.array([1, 2]))
    assert signal.shape == (2, 4, 2)
    assert np.array_equal(signal[0, :, 0], vectors[0, :, 3])
    assert not signal[0, :, 1].any()
    assert np.array_equal(signal[1, :, 1], vectors[1, :, 2])


@pytest.mark.parametrize("rank", [1, 2, 4])
@pytest.mark.parametrize("level", [5.0, 100.0, 1e5])
def test_tracked_subspace_is_the_exact_one(rank: int, level: float) -> None:
    rng = np.random.default_rng(4)
    count, snapshots, r = 64, np.full(64, 320.0), np.zeros((64, 32, 32), np.complex64)
    tracker = SubspaceTracker(32, rank)
    tracker.resize(count)
    a = np.exp(1j * rng.uniform(-3, 3, (count, 1, rank)) * np.arange(32)[:, None])
    for _ in range(10):
        s = rng.standard_normal((count, rank, 32)) + 1j * rng.standard_normal((count, rank, 32))
        noise = rng.standard_normal((count, 32, 32)) + 1j * rng.standard_normal((count, 32, 32))
        x = (np.sqrt(level / 32) * a @ s + noise).astype(np.complex64)
        r = r + x @ x.conj().swapaxes(1, 2)
        basis = tracker.update(np.arange(count), r, snapshots)
    exact = dominant(r.astype(np.complex128), rank)
    assert basis @ basis.conj().swapaxes(1, 2) == pytest.approx(
        np.broadcast_to(np.eye(rank), (count, rank, rank)), abs=1e-5
    )
    outside = basis - basis @ exact.conj().swapaxes(1, 2) @ exact
    values = np.linalg.eigvalsh(r)[:, ::-1]
    sampling = np.sqrt(values[:, 0] * values[:, rank] / 320) / (values[:, rank - 1] - values[:, rank])
    worst = np.linalg.norm(outside, axis=2).max(axis=1)
    assert np.median(worst / sampling) < 0.1


def test_a_subspace_without_gap_is_decomposed_in_full() -> None:
    r = sample([1.0] * 16, 16, 40).astype(np.complex64)
    tracker = SubspaceTracker(16, 1)
    tracker.resize(40)
    basis = tracker.update(np.arange(40), r, np.full(40, 1e9))
    exact = dominant(r.astype(np.complex128), 1)
    assert np.abs(np.einsum("kin,kin->k", basis, exact.conj())) == pytest.approx(np.ones(40), abs=1e-4)
