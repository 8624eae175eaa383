"""Tracks against filterpy's filters, and what people expect of a track."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from numpy.typing import NDArray

from chachart.node.estimation.tracking.mixture import Beliefs, Sightings, predicted, updated
from chachart.node.estimation.tracking.motion import STATIC, WALK, Model, Motion, Motions
from chachart.node.estimation.tracking.smoother import Past, smoothed
from chachart.node.estimation.tracking.tracker import Tracker

DRIVE_ALONE = Model("drive", 8.0, 0.0, 10.0)
STEP_S = 0.2


def _walk(users: int, steps: int, speed: float, seed: int = 0) -> NDArray[np.float64]:
    """Straight ways (T, U, 2)."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(0, 2 * np.pi, users)
    way = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return rng.uniform(-50, 50, (users, 2)) + speed * STEP_S * np.arange(steps)[:, None, None] * way


def _noisy(way: NDArray[Any], std: float, seed: int = 1) -> NDArray[np.float64]:
    return way + std * np.random.default_rng(seed).standard_normal(way.shape)


def _followed(
    seen: NDArray[Any], std: float, motion: Motion, lag: int = 0, times: NDArray[Any] | None = None
) -> tuple[NDArray[np.float64], Tracker]:
    tracker = Tracker(motion, lag)
    users = seen.shape[1]
    tracker.resize(users)
    found = []
    for i, points in enumerate(seen):
        at = np.full(users, round((i if times is None else times[i]) * STEP_S * 1e9), np.int64)
        sightings = Sightings.single(points, np.broadcast_to(std**2 * np.eye(2), (users, 2, 2)))
        found.append(tracker.update(np.arange(users), at, sightings).state)
    return np.array(found), tracker


def _kalman(motions: Motions, model: int, x: NDArray[Any], p: NDArray[Any], r: float) -> KalmanFilter:
    oracle = KalmanFilter(4, 2)
    dt = np.array([STEP_S])
    oracle.F, oracle.Q = motions.transition(dt)[0, model], motions.noise(dt)[0, model]
    oracle.H, oracle.R = np.eye(2, 4), r * np.eye(2)
    oracle.x, oracle.P = x.copy(), p.copy()
    return oracle


def test_one_model_and_one_alternative_are_a_kalman_filter_and_its_smoother() -> None:
    motions = Motions((WALK,))
    start = np.array([1.0, 2.0, 0.3, -0.2])
    around = np.diag([1.0, 2.0, 1.0, 1.0])
    oracle = _kalman(motions, 0, start, around, 0.5)
    beliefs = Beliefs(start[None, None].copy(), around[None, None].copy(), np.ones((1, 1)))
    rng = np.random.default_rng(2)
    states, covariances, theirs = [], [], []
    for _ in range(12):
        z = rng.normal(0, 2, 2)
        oracle.predict()
        oracle.update(z)
        seen = Sightings.single(z[None], 0.5 * np.eye(2)[None], none=1e-12)
        beliefs, evidence, _ = updated(predicted(beliefs, motions, np.array([STEP_S])), seen, 1e-9)
        np.testing.assert_allclose(beliefs.mean[0, 0], oracle.x, atol=1e-8)
        np.testing.assert_allclose(beliefs.covariance[0, 0], oracle.P, atol=1e-8)
        assert evidence[0] == pytest.approx(oracle.log_likelihood, abs=1e-6)
        states.append(beliefs.mean[:, 0])
        covariances.append(beliefs.covariance[:, 0])
        theirs.append((oracle.x.copy(), oracle.P.copy()))
    past = Past(
        (np.arange(12)[:, None] * STEP_S * 1e9).astype(np.int64),
        np.array(states),
        np.array(covariances),
        np.ones((12, 1, 1)),
        np.zeros(1, np.intp),
    )
    x, p, _, _ = oracle.rts_smoother(np.array([t[0] for t in theirs]), np.array([t[1] for t in theirs]))
    ours = smoothed(past, motions)
    np.testing.assert_allclose(ours[0][:, 0], x, atol=1e-6)
    np.testing.assert_allclose(ours[1][:, 0], p, atol=1e-6)


def test_several_models_are_an_interacting_multiple_model_filter() -> None:
    motions = Motions((DRIVE_ALONE, WALK))
    start = np.array([0.0, 0.0, 1.0, 0.0])
    around = np.diag([1.0, 1.0, 4.0, 4.0])
    switching = motions.switching(np.array([STEP_S]))[0]
    kalmans = [_kalman(motions, j, start, around, 0.04) for j in (0, 1)]
    oracle = IMMEstimator(kalmans, [0.5, 0.5], switching)
    shape = (1, 2, 1, 1)
    beliefs = Beliefs(np.tile(start, (1, 2, 1)), np.tile(around, shape), np.full((1, 2), 0.5))
    rng = np.random.default_rng(3)
    for i in range(20):
        z = np.array([0.3 * i, 0.0]) + rng.normal(0, 0.2, 2)
        oracle.predict()
        oracle.update(z)
        seen = Sightings.single(z[None], 0.04 * np.eye(2)[None], none=1e-12)
        beliefs, _, _ = updated(predicted(beliefs, motions, np.array([STEP_S])), seen, 1e-9)
        np.testing.assert_allclose(beliefs.model[0], oracle.mu, atol=1e-6)
        np.testing.assert_allclose(beliefs.merged()[0][0], oracle.x, atol=1e-6)
        np.testing.assert_allclose(beliefs.merged()[1][0], oracle.P, atol=1e-6)


@pytest.mark.parametrize(
    ("motion", "speed"), [("walk", 0.0), ("walk", 1.4), ("drive", 10.0), ("drive", 30.0)]
)
def test_a_track_is_better_than_what_it_is_made_of_and_says_how_good(motion: Motion, speed: float) -> None:
    way = _walk(200, 60, speed)
    found, tracker = _followed(_noisy(way, 0.5), 0.5, motion)
    error = found[30:, :, :2] - way[30:]
    assert np.sqrt(np.mean(error**2)) < 0.45
    _, covariance = tracker._beliefs(np.arange(200), 0).merged()
    last = error[-1]
    normalised = np.einsum("ui,uij,uj->u", last, np.linalg.inv(covariance[:, :2, :2]), last) / 2
    assert 0.3 < normalised.mean() < 1.3
    assert np.median(np.abs(np.linalg.norm(found[-1, :, 2:], axis=1) - speed)) < 0.2 * speed + 0.3


def test_a_lag_makes_it_better_still() -> None:
    way = _walk(100, 60, 1.4)
    seen = _noisy(way, 0.5)
    live, _ = _followed(seen, 0.5, "walk")
    late, _ = _followed(seen, 0.5, "walk", lag=8)
    error_live = np.sqrt(np.mean((live[30:52, :, :2] - way[30:52]) ** 2))
    error_late = np.sqrt(np.mean((late[38:, :, :2] - way[30:52]) ** 2))
    assert error_late < 0.8 * error_live


def test_single_outliers_move_nothing() -> None:
    way = _walk(50, 40, 1.4)
    seen = _noisy(way, 0.2)
    seen[20] += 25
    found, _ = _followed(seen, 0.2, "walk")
    assert np.abs(found[20, :, :2] - way[20]).max() < 1.5


def test_a_track_that_followed_an_echo_comes_back() -> None:
    way = _walk(50, 60, 1.4)
    seen = _noisy(way, 0.2)
    seen[:20] += 40
    found, _ = _followed(seen, 0.2, "walk")
    assert np.linalg.norm(found[45, :, :2] - way[45], axis=1).max() < 1.5


def test_of_several_alternatives_the_one_that_fits_counts() -> None:
    way = _walk(50, 40, 1.4)
    seen = _noisy(way, 0.2)
    tracker = Tracker("walk")
    tracker.resize(50)
    for i, points in enumerate(seen):
        rival = points + np.array([30.0, -20.0])
        points2 = np.stack([rival, points], axis=1)
        logs = np.log([0.01, 0.99]) if i < 10 else np.log([0.8, 0.2])  # later on the wrong one is likelier
        sightings = Sightings(
            points2, np.tile(0.04 * np.eye(2), (50, 2, 1, 1)), np.tile(logs, (50, 1)), np.full(50, 0.1)
        )
        time_ns = np.full(50, i * 200_000_000, np.int64)
        found = tracker.update(np.arange(50), time_ns, sightings)
    assert np.linalg.norm(found.state[:, :2] - way[-1], axis=1).max() < 1.0


def test_late_observations_count_at_their_own_time() -> None:
    way = _walk(100, 41, 10.0)
    seen = _noisy(way, 0.5)
    order = np.arange(41)
    order[1::2], order[2::2] = np.arange(41)[2::2], np.arange(41)[1::2]  # pairs exchanged
    found, _ = _followed(seen[order], 0.5, "drive", times=order)
    half, _ = _followed(seen[order][1::2], 0.5, "drive", times=order[1::2])
    newest = way[40 - 1 + 1]
    error = np.sqrt(np.mean((found[-1, :, :2] - newest) ** 2))
    assert error < np.sqrt(np.mean((half[-1, :, :2] - newest) ** 2))
    assert error < 0.6


def test_after_a_long_silence_a_track_starts_afresh() -> None:
    tracker = Tracker("walk")
    tracker.resize(1)
    slot = np.array([0])
    for second, x in ((0, 0.0), (1, 1.0), (500, 80.0)):
        seen = Sightings.single(np.array([[x, 0.0]]), 0.01 * np.eye(2)[None])
        found = tracker.update(slot, np.array([second * 10**9]), seen)
    assert found.state[0].tolist() == [80.0, 0.0, 0.0, 0.0]


def test_tracks_can_be_saved_and_go_on_elsewhere() -> None:
    way = _noisy(_walk(10, 20, 1.4), 0.3)
    _, tracker = _followed(way[:19], 0.3, "drive", lag=3)
    other = Tracker("drive", 3)
    other.resize(10)
    other.restore(tracker.snapshot())
    seen = Sightings.single(way[19], np.broadcast_to(0.09 * np.eye(2), (10, 2, 2)))
    time_ns = np.full(10, round(19 * STEP_S * 1e9), np.int64)
    one = tracker.update(np.arange(10), time_ns, seen)
    two = other.update(np.arange(10), time_ns, seen)
    np.testing.assert_array_equal(one.state, two.state)


def test_models_are_entered_and_left_with_probabilities() -> None:
    for motion in ("static", "walk", "drive"):
        motions = Tracker(motion).motions  # type: ignore[arg-type]
        switching = motions.switching(np.array([0.01, 1.0, 50.0]))
        np.testing.assert_allclose(switching.sum(axis=2), 1)
        assert (switching >= 0).all()
    still, _ = _followed(_noisy(np.zeros((40, 30, 2)), 0.3), 0.3, "static")
    assert np.abs(still[-1, :, :2]).max() < 0.4
    assert STATIC.speed_m_s == 0
