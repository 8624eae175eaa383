import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.manifold import trustworthiness

from chachart.node.estimation.quality import kruskal_stress, neighbourhoods


def cloud(n: int, noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0, 500, (n, 2))
    return truth, truth + noise * rng.standard_normal((n, 2))


@pytest.mark.parametrize(("n", "k"), [(10, 1), (10, 4), (257, 12), (1200, 60)])
@pytest.mark.parametrize("noise", [0.0, 5.0, 1000.0])
def test_agrees_with_scikit_learn(n: int, k: int, noise: float) -> None:
    truth, chart = cloud(n, noise)
    got = neighbourhoods(truth, chart, k)
    assert got.tw == pytest.approx(trustworthiness(truth, chart, n_neighbors=k), abs=1e-12)
    assert got.ct == pytest.approx(trustworthiness(chart, truth, n_neighbors=k), abs=1e-12)
    assert (got.tw_error, got.ct_error, got.anchors) == (0, 0, n)


def by_definition(truth: np.ndarray, chart: np.ndarray, k: int) -> float:
    """TW, slowly; of equal distances the lower index is nearer."""
    n, total = len(truth), 0
    for i in range(n):
        others = [j for j in range(n) if j != i]
        order = sorted(others, key=lambda j: (((truth[i] - truth[j]) ** 2).sum(), j))
        near = sorted(others, key=lambda j: (((chart[i] - chart[j]) ** 2).sum(), j))[:k]
        total += sum(max(order.index(j) + 1 - k, 0) for j in near)
    return 1 - 2 * total / (n * k * (2 * n - 3 * k - 1))


@settings(deadline=None, max_examples=60)
@given(
    st.integers(3, 14).flatmap(
        lambda n: st.tuples(
            st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2)), min_size=n, max_size=n),
            st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2)), min_size=n, max_size=n),
            st.integers(1, (n - 1) // 2),
        )
    )
)
def test_ties_go_to_the_lower_index(case: tuple[list[tuple[int, int]], list[tuple[int, int]], int]) -> None:
    truth, chart, k = np.array(case[0], float), np.array(case[1], float), case[2]
    got = neighbourhoods(truth, chart, k)
    assert got.tw == pytest.approx(by_definition(truth, chart, k), abs=1e-12)
    assert got.ct == pytest.approx(by_definition(chart, truth, k), abs=1e-12)


@pytest.mark.parametrize("points", [3000, 9000])
def test_sampled_within_its_standard_error(points: int) -> None:
    """Of the larger chart only some points are ranked at all."""
    truth, chart = cloud(points, 40.0)
    k = points // 30
    exact = neighbourhoods(truth[:3000], chart[:3000], 100)
    for seed in range(3):
        got = neighbourhoods(truth, chart, k, rng=np.random.default_rng(seed))
        assert got.k == k
        assert 0 < got.tw_error < 1e-3
        assert abs(got.tw - exact.tw) < 4 * got.tw_error + 1e-3
        assert abs(got.ct - exact.ct) < 4 * got.ct_error + 1e-3


@pytest.mark.parametrize(("n", "k"), [(10, 5), (2, 1), (10, 0)])
def test_k_must_be_below_half(n: int, k: int) -> None:
    with pytest.raises(ValueError, match="k must be at least 1 and below half"):
        neighbourhoods(*cloud(n, 1.0), k)


def test_unknown_coordinates_are_refused() -> None:
    truth, chart = cloud(10, 1.0)
    chart[3, 1] = np.nan
    for measure in (neighbourhoods, kruskal_stress):
        with pytest.raises(ValueError, match="finite"):
            measure(truth, chart)
        with pytest.raises(ValueError, match="as many"):
            measure(truth, chart[:4])


def test_stress() -> None:
    truth, chart = cloud(300, 0.0)
    assert kruskal_stress(truth, 3 * chart + 7) == pytest.approx(0, abs=1e-7)
    assert kruskal_stress(truth, np.zeros_like(chart)) == 1
    stress = kruskal_stress(*cloud(300, 30.0))
    assert 0.05 < stress < 0.3
    assert kruskal_stress(*cloud(300, 30.0), most=200) == pytest.approx(stress, rel=0.2)


@pytest.mark.parametrize(("ues", "k"), [(4, 1), (8, 3), (12, 5), (60, 5), (200, 10)])
def test_few_ues_are_judged_by_more_than_their_one_neighbour(ues: int, k: int) -> None:
    truth = np.random.default_rng(0).normal(size=(ues, 2))
    assert neighbourhoods(truth, truth).k == k
