from __future__ import annotations

import numpy as np
import pytest
from sklearn.manifold import trustworthiness

from chachart.node.estimation.curves import neighbour_ranks, neighbourhood_curves
from chachart.node.estimation.quality import neighbourhoods


def spaces(n: int = 120) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    truth = rng.uniform(0, 100, (n, 2))
    return truth, truth + rng.normal(0, 8, (n, 2))


def test_every_k_agrees_with_scikit_learn_and_with_the_single_figure() -> None:
    truth, chart = spaces()
    tw, ct = neighbourhood_curves(neighbour_ranks(truth), neighbour_ranks(chart), 59)
    assert tw.shape == ct.shape == (59,)
    for k in (1, 2, 7, 30, 59):
        assert tw[k - 1] == pytest.approx(trustworthiness(truth, chart, n_neighbors=k), abs=1e-12)
        assert ct[k - 1] == pytest.approx(trustworthiness(chart, truth, n_neighbors=k), abs=1e-12)
        single = neighbourhoods(truth, chart, k)
        assert (tw[k - 1], ct[k - 1]) == pytest.approx((single.tw, single.ct), abs=1e-12)


def test_equal_distances_are_ranked_by_index() -> None:
    grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2)
    ranks = neighbour_ranks(grid)
    assert (np.sort(ranks, axis=1) == np.arange(64)).all()
    assert (np.diagonal(ranks) == 0).all()
    assert (ranks[0, 1], ranks[0, 8]) == (1, 2)
    chart = grid[:, ::-1] * [1.0, 2.0]
    single = neighbourhoods(grid, chart, 9)
    tw, ct = neighbourhood_curves(ranks, neighbour_ranks(chart), 9)
    assert (tw[-1], ct[-1]) == pytest.approx((single.tw, single.ct), abs=1e-12)


def test_a_perfect_chart_has_perfect_curves() -> None:
    truth, _ = spaces()
    ranks = neighbour_ranks(truth)
    tw, ct = neighbourhood_curves(ranks, neighbour_ranks(3 * truth[:, ::-1] + 1), 20)
    assert (tw == 1).all()
    assert (ct == 1).all()


def test_what_cannot_be_ranked_is_told() -> None:
    truth, chart = spaces(20)
    with pytest.raises(ValueError, match="finite"):
        neighbour_ranks(np.full((3, 2), np.nan))
    with pytest.raises(ValueError, match="10 < 20 / 2"):
        neighbourhood_curves(neighbour_ranks(truth), neighbour_ranks(chart), 10)
