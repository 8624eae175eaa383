from __future__ import annotations

import sys

import numpy as np
import pytest

from chachart.node.commands.reproduction.accuracy import Accuracy
from chachart.node.commands.reproduction.embeddings import aligned, principal_components, sammon
from chachart.node.commands.reproduction.paper import PAIRS, published
from chachart.node.commands.reproduction.progress import steps
from chachart.node.commands.reproduction.report import compared
from chachart.node.commands.reproduction.scenario import KNOWN_UES, modelled, scenario_array


def test_published_rows_belong_to_their_pairs() -> None:
    assert published("los", ("mvdr", "lr")) == (0.9796, 0.9816, 6.4927)
    assert published("qnlos", ("music", "music")) == (0.9854, 0.9867, None)
    assert published("los", ("joint", "joint")) is None
    assert len(set(PAIRS)) == 11


def test_only_the_first_block_knows_positions_and_each_ue_is_in_one_block() -> None:
    scene = modelled("los", scenario_array(10e6), 600, 2, 0.0, 0)
    for random_training in (False, True):
        blocks = list(scene.blocks(random_training=random_training))
        known = [np.isfinite(block.position).all(axis=1) for block in blocks if block.position is not None]
        assert [bool(k.all()) for k in known] == [True] + [False] * 6
        assert not np.concatenate(known[1:]).any()
        ues = [np.unique(block.ue) for block in blocks]
        assert len(ues[0]) == KNOWN_UES
        assert (np.sort(np.concatenate(ues)) == np.arange(600)).all()
        for block in blocks:
            assert (block.csi == scene.csi[block.ue[::2].astype(int)].reshape(-1, 32, 32)).all()
        assert (ues[0] == np.arange(KNOWN_UES)).all() == (not random_training)


def test_noise_has_the_power_that_the_snr_asks_for() -> None:
    array = scenario_array(10e6)
    quiet, loud = (modelled("los", array, 100, 4, snr, 0).csi for snr in (200.0, -10.0))
    assert np.mean(np.abs(quiet) ** 2) == pytest.approx(1.0, rel=1e-4)
    assert np.mean(np.abs(loud - quiet) ** 2) == pytest.approx(10.0, rel=0.01)


def test_sammon_finds_a_plane_that_is_there() -> None:
    rng = np.random.default_rng(0)
    plane = rng.uniform(0, 1, (200, 2))
    turn = np.linalg.qr(rng.normal(size=(9, 9)))[0][:2]
    features = plane @ turn + 3
    components = principal_components(features)
    assert aligned(components, plane) == pytest.approx(plane, abs=1e-6)
    rough = components + rng.normal(0, 0.05, components.shape)
    assert np.abs(aligned(sammon(features, rough), plane) - plane).max() < 0.02


def test_a_threshold_is_where_the_error_leaves_the_bound_for_good() -> None:
    snrs = np.array([-20.0, -15.0, -10.0, 0.0])
    bound = np.array([4.0, 2.0, 1.0, 0.5])
    rmse = {"music": bound * [9, 1, 1.3, 1.1], "joint": bound * 0.5, "mvdr": bound * 2}
    accuracy = Accuracy("theta", "°", 1e6, snrs, rmse, bound, bound / 2)
    assert accuracy.threshold_db("music") == 0
    assert accuracy.threshold_db("joint") == -20
    assert accuracy.threshold_db("mvdr") is None
    assert accuracy.judged("music") == pytest.approx((1.2, 1.3))


def test_better_and_worse_are_told_to_the_digits_that_were_published() -> None:
    assert compared(0.99984, 0.9998).text == "="
    assert compared(0.99986, 0.9998).verdict == "good"
    assert compared(0.9911, 0.9912).text == "▼ -0.0001"


def test_progress_in_a_pipe_ends_with_the_last_step(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False)
    with steps(3) as told:
        for word in ("one", "two", "three"):
            told(word)
    assert capsys.readouterr().err.splitlines()[-1].endswith("three")
