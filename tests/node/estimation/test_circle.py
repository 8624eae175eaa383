"""Lag polynomials all round the circle, by table and by FFT alike."""

from __future__ import annotations

import numpy as np
import pytest

from chachart.node.estimation.circle import TABLE_LIMIT, Circle


@pytest.mark.parametrize("lags", [np.arange(9), np.arange(TABLE_LIMIT + 40), np.arange(0, 900, 3)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shift", [0, 7])
def test_values_are_those_of_the_sum(lags: np.ndarray, dtype: type, shift: int) -> None:
    rng = np.random.default_rng(len(lags))
    points = 2 * int(lags[-1] + 1)
    c = rng.standard_normal((5, len(lags))) + 1j * rng.standard_normal((5, len(lags)))
    at = np.arange(points) - shift
    u = 2 * np.pi * at / points
    window = rng.random(len(lags))
    exact = ((c * window) @ np.exp(1j * np.outer(lags, u))).real
    values = Circle(lags, points, at, dtype, window).values(c)
    np.testing.assert_allclose(values, exact, atol=(1e-3 if dtype is np.float32 else 1e-9))
