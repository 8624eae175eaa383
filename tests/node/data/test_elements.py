from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chachart.node.data.elements import circle, grid, lattice, line, mirror, on_one_line, partners


@given(st.integers(1, 6), st.integers(1, 6), st.floats(0.01, 1), st.floats(0.01, 1), st.randoms())
def test_a_board_is_found_whatever_the_order_of_its_elements(rows, columns, across, down, random) -> None:
    order = list(range(rows * columns))
    random.shuffle(order)
    board = lattice(grid(rows, columns, across, down)[order])
    assert board is not None
    assert (board.rows, board.columns) == (rows, columns)
    if columns > 1:
        assert board.column_spacing_m == pytest.approx(across)
    if rows > 1:
        assert board.row_spacing_m == pytest.approx(down)
    for n, number in enumerate(order):
        assert board.row[n] == rows - 1 - number // columns  # row 0 of the numbers is on top
        assert board.column[n] == number % columns


def test_what_is_no_board_is_none() -> None:
    assert lattice(circle(5, 0.1)) is None
    assert lattice(grid(2, 3, 0.1)[:-1]) is None
    assert lattice(np.array([[0, 0, 0], [0.1, 0, 0], [0.3, 0, 0.0]])) is None
    assert lattice(np.array([[0, 0, 0], [0.1, 0, 0.05]])) is None


def test_planes_and_lines() -> None:
    np.testing.assert_allclose(mirror(grid(2, 4, 0.1)), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(mirror(circle(5, 0.1)), [0, 1, 0], atol=1e-12)
    assert mirror(line(4, 0.1)) is None
    assert mirror(np.random.default_rng(0).normal(size=(6, 3))) is None
    assert on_one_line(np.array([[0.0, 1, 2], [0.1, 1, 2], [0.4, 1, 2]]))
    assert not on_one_line(circle(5, 0.1))


def test_partners_are_across_the_middle() -> None:
    np.testing.assert_array_equal(partners(grid(2, 2, 0.1)), [3, 2, 1, 0])
    np.testing.assert_array_equal(partners(circle(4, 0.1)), [2, 3, 0, 1])
    assert partners(circle(5, 0.1)) is None


def test_a_circle_turns_from_normal_to_right() -> None:
    np.testing.assert_allclose(circle(4, 2.0), [[0, 0, 2], [2, 0, 0], [0, 0, -2], [-2, 0, 0]], atol=1e-12)
