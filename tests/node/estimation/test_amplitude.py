"""What ranges by amplitude say of their errors, against channels whose law is known."""

from typing import Any

import numpy as np
import pytest

from chachart.node.estimation.amplitude import Isq, Lr, PowerLaw

SCATTER = 0.3


def world(ues: int, scatter: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """s, rho and positions, with s = rho^-1 but for lognormal shadows, each UE in a shadow of its own."""
    rng = np.random.default_rng(seed)
    rho = rng.uniform(100, 600, ues)
    s = 1e3 / rho * np.exp(scatter * rng.standard_normal(ues))
    return s, rho, np.stack([1e3 * np.arange(ues), np.zeros(ues), np.zeros(ues)], axis=1)


def ranged(method: Any, s: np.ndarray, rho: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Errors over deviations, of UEs that did not train: only the first half's positions are known."""
    known = np.where(np.arange(len(s)) < len(s) // 2, rho, np.nan)
    method.resize(len(s))
    method.clear(np.arange(len(s)))
    found, std = method.ranges(np.arange(len(s)), s, known, position)
    return ((found - rho) / std)[len(s) // 2 :]


@pytest.mark.parametrize("method", [Isq(None), Lr(4096, log_range=False), Lr(4096, log_range=True)])
def test_errors_have_the_variance_that_is_told(method: Any) -> None:
    z = ranged(method, *world(8192, SCATTER))
    assert np.mean(z**2) == pytest.approx(1, abs=0.15)
    assert 0.9 < np.mean(np.abs(z) < 1.96) < 0.99


@pytest.mark.parametrize("method", [Isq(None), Lr(4096, log_range=False)])
def test_without_shadows_the_law_tells_how_far_a_method_is_off(method: Any) -> None:
    """Neither method has the right law; both know the error then."""
    z = ranged(method, *world(8192, 0.0))
    assert np.abs(z) == pytest.approx(1, abs=1e-3)


def test_without_a_scale_there_is_no_deviation() -> None:
    s, _, position = world(16, SCATTER)
    isq = Isq(None)
    assert np.isnan(isq.ranges(np.arange(16), s, np.full(16, np.nan), position)[1]).all()
    found, std = Isq((100.0, 10.0)).ranges(np.arange(16), s, np.full(16, np.nan), position)
    np.testing.assert_allclose(std, PowerLaw.UNTRAINED * found)


def test_ues_in_one_shadow_tell_no_more_than_one() -> None:
    """The same points crowded together leave the fit less sure than points far apart."""
    s, rho, apart = world(64, SCATTER)
    crowded = np.tile(apart[:1], (64, 1))
    told = []
    for position in (apart, crowded):
        lr = Lr(64, log_range=True)
        lr.resize(64)
        lr.clear(np.arange(64))
        told.append(lr.ranges(np.arange(64), s, rho, position)[1])
    assert (told[1] > 1.3 * told[0]).all()
