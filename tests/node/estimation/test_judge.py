"""What estimates say of their errors where there are echoes, and the probability of a direct path."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from chachart.config.settings import ArraySettings
from chachart.node.commands.train import fit, gather
from chachart.node.commands.training import draws
from chachart.node.estimation.evidence import AxisEvidence
from chachart.node.estimation.judge import Judge, inflated, judge, probability, unjudged
from chachart.node.estimation.lattice import Lattice

Build = Callable[..., Any]
WIDE = {"subcarrier_spacing_hz": 312.5e3}


def draw(channel: str, seed: int = 900_001, snr_db: float = 0.0, ues: int = 256) -> draws.Draw:
    return draws.Draw(channel, ArraySettings(**WIDE).geometry(), snr_db, 10, ues, seed)


@pytest.mark.parametrize("method", ["bartlett", "mvdr", "music", "joint"])
@pytest.mark.parametrize("channel", ["los", "qlos", "qnlos"])
def test_errors_have_the_variance_that_is_told(method: str, channel: str) -> None:
    """A draw that nothing was trained on; for noise alone it would be up to 1000 in multipath."""
    world = draw(channel)
    csi, theta, rho = draws.world(world)
    at = draws.located(world, csi, method)
    for name, truth in (("theta", theta), ("rho", rho)):
        z = (at[name] - truth) / at[f"{name}_std"]
        assert 0.3 < np.mean(np.minimum(z**2, 25)) < 2.5
        assert 0.85 < np.mean(np.abs(z) < 1.96) < 0.999


def test_directness_is_what_is_told() -> None:
    """Of UEs that are said to be seen directly with a probability, so many are."""
    world = draw("qnlos", ues=512)
    csi, theta, rho = draws.world(world)
    at = draws.located(world, csi, "joint")
    direct = (np.abs(np.cos(at["theta"]) - np.cos(theta)) < world.cells[0] / 2) & (
        np.abs(at["rho"] - rho) < world.cells[1] / 2
    )
    p = at["p_direct"]
    assert p.mean() == pytest.approx(direct.mean(), abs=0.08)
    sure = p > np.median(p)
    assert direct[sure].mean() > direct[~sure].mean() + 0.02
    los = draws.world(draw("los"))[0]
    assert draws.located(draw("los"), los, "joint")["p_direct"].min() > 0.9


def test_a_lone_wave_leaves_nothing_unexplained() -> None:
    lattice = Lattice.even(16)
    u = np.array([0.3, -2.0])
    lags = np.exp(-1j * np.outer(u, lattice.lags)) * 2 * lattice.pairs / lattice.size
    lags[:, 0] = 1 + 0.01

    def named_evidence(lags: np.ndarray) -> dict[str, np.ndarray]:
        turned = lags * np.exp(1j * np.outer(u, lattice.lags))
        columns = AxisEvidence(lattice, 0.1).of(lags, turned, np.full(2, 1e-3), np.full(2, 1e4)).T
        return dict(zip(AxisEvidence.NAMES, columns, strict=True))

    named = named_evidence(lags)
    assert named["snr"] == pytest.approx(np.log(100), rel=0.05)
    assert (named["unexplained"] < np.log(0.01)).all()
    assert named["turn2"] == pytest.approx(np.log(1e-4))
    echo = lags + 0.5 * np.exp(-1j * np.outer(u + 0.2, lattice.lags)) * 2 * lattice.pairs / lattice.size
    worse = named_evidence(echo)
    for name in ("unexplained", "loss2", "turn2"):
        assert (worse[name] > named[name] + 1).all()


def test_what_is_trained_is_what_was_drawn() -> None:
    """A network fitted to a few draws tells their errors' variance, and is read back from plain values."""
    samples = gather(8, 64, seed=3)
    on_axes = {f"{m}.{n}" for m in draws.METHODS[:-1] for n in ("theta", "rho")}
    assert set(samples) == on_axes | set(draws.METHODS)
    sample = samples["bartlett.rho"]
    found = fit(sample, 0)
    again = Judge(**{key: np.array(value) for key, value in found.as_dict().items()})
    growth, direct = again(sample["evidence"]).T
    np.testing.assert_allclose(growth, found(sample["evidence"])[:, 0], atol=0.02)
    z = sample["rho_error"] / inflated(sample["rho_std"], growth)
    assert np.mean(z**2) == pytest.approx(1, abs=0.3)
    assert probability(direct).mean() == pytest.approx(sample["direct"].mean(), abs=0.03)


def test_evidence_can_be_collected_without_a_judge() -> None:
    evidence = np.zeros((3, 5))
    with unjudged():
        assert judge("nobody", 2)(evidence).shape == (3, 2)
    with pytest.raises(KeyError):
        judge("nobody", 2)
