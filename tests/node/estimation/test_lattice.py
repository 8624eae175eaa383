"""Places of elements, and the lag polynomials over them, against sums written out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.estimation.lag_sums import LagSums
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.manifold import AngleManifold, derivatives, phasors, polynomial_table
from chachart.node.estimation.noise import NoiseFloor

numbers = st.sets(st.integers(-300, 300), min_size=2, max_size=12).map(sorted)


@given(numbers)
def test_places_are_the_numbers_in_steps_of_their_common_divisor(values: list[int]) -> None:
    lattice, step = Lattice.of(np.array(values))
    np.testing.assert_array_equal(values[0] + step * lattice.index, values)
    assert np.gcd.reduce(lattice.index) == 1
    assert lattice.pairs.sum() == lattice.size * (lattice.size + 1) / 2
    assert lattice.moment == pytest.approx(lattice.size * np.var(lattice.index))


@given(numbers, st.integers(0, 2**32 - 1))
def test_lag_sums_give_the_quadratic_form(values: list[int], seed: int) -> None:
    """Dense, with gaps, or sparse; from factors and from matrices."""
    rng = np.random.default_rng(seed)
    lattice, _ = Lattice.of(np.array(values))
    n = lattice.size
    x = rng.standard_normal((3, n, 4)) + 1j * rng.standard_normal((3, n, 4))
    q = x @ x.conj().swapaxes(1, 2)
    u = rng.uniform(-np.pi, np.pi, 3)
    a = AngleManifold(lattice, -np.pi, np.pi, np.pi).steering(u)
    np.testing.assert_allclose(a, np.exp(1j * u[:, None] * lattice.index), atol=1e-9)
    expected = np.einsum("kn,knm,km->k", a.conj(), q, a).real
    sums = LagSums(lattice)
    for c in (sums.of(q), sums.of_products(x)):
        assert c.shape == (3, len(lattice.lags))
        value = derivatives(np.ascontiguousarray(c.T), u, lattice)[0]
        np.testing.assert_allclose(value, expected, atol=1e-8 * np.abs(q).sum())
        table = np.ascontiguousarray(c).view(float) @ polynomial_table(u, lattice.lags)
        np.testing.assert_allclose(np.diag(table), expected, atol=1e-8 * np.abs(q).sum())


def test_kinds_of_rows() -> None:
    assert Lattice.even(8).dense
    assert Lattice.even(8).symmetric
    gaps = Lattice((0, 1, 3, 4))
    assert not gaps.dense
    assert not gaps.sparse
    assert gaps.symmetric
    assert not Lattice((0, 1, 3)).symmetric
    far = Lattice((0, 1, 1000, 1001))
    assert far.sparse
    np.testing.assert_array_equal(far.lags, [0, 1, 999, 1000, 1001])
    np.testing.assert_array_equal(far.pairs, [4, 2, 1, 2, 1])
    np.testing.assert_array_equal(phasors(np.zeros(2), far.index), np.ones((4, 2)))


def test_zeros_take_the_places_of_gaps() -> None:
    x = np.arange(1, 7).reshape(2, 3)
    np.testing.assert_array_equal(Lattice((0, 2, 3)).spread_out(x, 1), [[1, 0, 2, 3], [4, 0, 5, 6]])
    assert Lattice.even(3).spread_out(x, 1) is x


@pytest.mark.parametrize("places", [tuple(range(0, 12)), (0, 1, 2, 3, 6, 7, 9, 10, 11, 12, 13, 15)])
def test_noise_floor_of_a_path_and_noise(places: tuple[int, ...]) -> None:
    """Gaps or not, a strong path does not pass for noise."""
    rng = np.random.default_rng(0)
    lattice, m, ues = Lattice(places), 400, 200
    n = lattice.size
    noise = (rng.standard_normal((ues, n, m)) + 1j * rng.standard_normal((ues, n, m))) / np.sqrt(2)
    a = np.exp(1j * rng.uniform(-np.pi, np.pi, (ues, 1)) * lattice.index)
    x = noise + 10 * a[:, :, None] * np.exp(2j * np.pi * rng.random((ues, 1, m)))
    c = LagSums(lattice).of_products(x) / (m * n)
    power = NoiseFloor(lattice).power(c, np.full(ues, float(m)))
    assert np.median(power) == pytest.approx(1, rel=0.35)


@pytest.mark.parametrize("columns", [1, 4, 5, 8, 40])
@pytest.mark.parametrize(
    "places", [[0, 1, 2, 4, 5, 6, 7], [0, 1, 3, 4], [*range(8), *range(9, 20)], [*range(70), 71]]
)
def test_products_of_rows_with_gaps_have_the_lags_of_their_matrices(places: list[int], columns: int) -> None:
    rng = np.random.default_rng(columns)
    x = rng.standard_normal((3, len(places), columns)) + 1j * rng.standard_normal((3, len(places), columns))
    sums = LagSums(Lattice.of(np.array(places))[0])
    q = x @ x.conj().swapaxes(1, 2)
    truth = np.zeros((3, places[-1] + 1), complex)
    for m, first in enumerate(places):
        for n, second in enumerate(places):
            if second >= first:
                truth[:, second - first] += q[:, m, n] * (1 if m == n else 2)
    np.testing.assert_allclose(sums.of_products(x)[:, : places[-1] + 1], truth, atol=1e-9)
