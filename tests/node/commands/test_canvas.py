from __future__ import annotations

import numpy as np
import pytest

from chachart.node.commands.shared.canvas import characters, fit, scatter


def test_each_dot_has_its_place() -> None:
    y, x = np.mgrid[0:4, 0:2] + 0.5
    for n, dot in enumerate("⠁⠈⠂⠐⠄⠠⡀⢀"):
        dots, owner = scatter(x.ravel()[n : n + 1], 4 - y.ravel()[n : n + 1], (0, 2, 0, 4), 1, 1)
        assert characters(dots) == [dot]
        assert owner.tolist() == [[0]]


def test_dots_share_characters() -> None:
    x, y = np.array([0.5, 1.5, 3.5]), np.array([7.5, 7.5, 0.5])
    dots, owner = scatter(x, y, (0, 4, 0, 8), 2, 2)
    assert characters(dots) == ["⠉⠀", "⠀⢀"]
    assert owner.tolist() == [[1, -1], [-1, 2]]


def test_what_is_outside_is_left_out() -> None:
    x = np.array([-1.0, 5.0, np.nan, 1.0, np.inf])
    dots, owner = scatter(x, np.ones(5), (0, 4, 0, 8), 2, 2)
    assert np.count_nonzero(dots) == 1
    assert owner.max() == 3


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (10, 50), (3, 3)])
def test_bounds_keep_the_scale_of_both_axes(columns: int, rows: int) -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(100, 600, 500), rng.uniform(-500, 500, 500)
    x[0], y[1] = 1e6, np.nan
    left, right, bottom, top = fit(x, y, columns, rows)
    assert (right - left) / (2 * columns) == pytest.approx((top - bottom) / (4 * rows))
    inside = (x > left) & (x < right) & (y > bottom) & (y < top)
    assert inside.sum() > 470


def test_bounds_of_nothing() -> None:
    assert fit(np.array([]), np.array([]), 10, 10) == (-1.0, 1.0, -1.0, 1.0)
    left, right, *_ = fit(np.array([5.0]), np.array([5.0]), 10, 10)
    assert left < 5 < right
