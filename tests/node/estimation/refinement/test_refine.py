from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from chachart.node.commands.benchmarks.fusion import HALL_M, hall, heard
from chachart.node.estimation.fusion.area import Area
from chachart.node.estimation.fusion.fuser import Fuser
from chachart.node.estimation.fusion.receiver import Receiver
from chachart.node.estimation.fusion.site import Site
from chachart.node.estimation.refinement.graph import graph, nearest
from chachart.node.estimation.refinement.profile import LENGTH, Profiler
from chachart.node.estimation.refinement.refine import Refined, refine

Floats = NDArray[np.float64]

STREET = Path(__file__).parents[5] / "shared" / "data" / "raytraced" / "street_static.npz"
UES, SIDE_M = 600, 100.0


def _profiles(place: Floats) -> NDArray[np.float32]:
    """What channels that change with the place on a scale of 20 m would give (U, LENGTH)."""
    waves = np.random.default_rng(1).standard_normal((2, LENGTH)) / 20
    return np.cos(place @ waves + np.arange(LENGTH)).astype(np.float32)


def _refined(
    profiles: NDArray[np.float32], place: Floats, outlier: Floats, tops: Floats | None = None
) -> Refined:
    neighbours = graph(profiles, place, outlier <= np.median(outlier))
    scores = None if tops is None else np.zeros(tops.shape[:2])
    return refine(neighbours, place, np.zeros((len(place), 2, 2)), outlier, tops, scores)


@pytest.fixture
def truth() -> Floats:
    return np.random.default_rng(2).uniform(0, SIDE_M, (UES, 2))


def test_a_perfect_chart_is_not_moved(truth: Floats) -> None:
    found = _refined(_profiles(truth), truth, np.full(UES, 0.05))
    assert not found.moved.any()
    np.testing.assert_array_equal(found.place, truth)


def test_outliers_go_to_where_their_neighbours_are(truth: Floats) -> None:
    rng = np.random.default_rng(3)
    bad = rng.random(UES) < 0.15
    place = np.where(bad[:, None], rng.uniform(0, SIDE_M, (UES, 2)), truth)
    found = _refined(_profiles(truth), place, np.where(bad, 0.4, 0.05))
    error = np.linalg.norm(found.place - truth, axis=1)
    before = np.linalg.norm(place - truth, axis=1)
    assert np.median(before[bad]) > 30
    assert np.median(error[bad]) < 3  # neighbours are 4 m apart
    assert np.median(error[~bad]) == 0


def test_of_its_own_maxima_a_ue_takes_the_one_near_its_neighbours(truth: Floats) -> None:
    rng = np.random.default_rng(4)
    bad = rng.random(UES) < 0.1
    place = np.where(bad[:, None], rng.uniform(0, SIDE_M, (UES, 2)), truth)
    tops = np.stack([place, truth], axis=1)
    found = _refined(_profiles(truth), place, np.where(bad, 0.6, 0.05), tops)
    exact = (found.place == truth).all(axis=1)
    assert exact[bad].mean() > 0.8


def test_profiles_of_unrelated_channels_move_nothing(truth: Floats) -> None:
    """Neighbours who live far apart are no witnesses."""
    profiles = np.random.default_rng(5).standard_normal((UES, LENGTH)).astype(np.float32)
    place = truth + np.random.default_rng(6).normal(0, 3, truth.shape)
    neighbours = graph(profiles, place, np.ones(UES, np.bool_))
    found = refine(neighbours, place, np.tile(9 * np.eye(2), (UES, 1, 1)), np.zeros(UES))
    assert np.mean(found.moved) < 0.02


def test_nearest_is_what_all_pairs_say(truth: Floats) -> None:
    profiles = _profiles(truth)
    others, unlike = nearest(profiles, 5)
    unit = profiles / np.linalg.norm(profiles, axis=1, keepdims=True)
    chords = np.linalg.norm(unit[:, None] - unit[None], axis=2)
    np.fill_diagonal(chords, np.inf)
    np.testing.assert_allclose(np.sort(unlike, axis=1), np.sort(chords, axis=1)[:, :5], atol=2e-3)
    assert not (others == np.arange(UES)[:, None]).any()


def test_too_few_ues_are_refused(truth: Floats) -> None:
    with pytest.raises(ValueError, match="10 UEs are too few"):
        graph(_profiles(truth[:10]), truth[:10], np.ones(10, np.bool_))


def _echoing(blocked: NDArray[np.bool_], places: Floats) -> tuple[list[Site], list[NDArray[np.complex64]]]:
    """Frames of four boards in a hall whose walls mirror UEs; of some UEs the direct waves are missing."""
    rng = np.random.default_rng(7)
    boards = hall()
    frames = []
    for board in boards:
        csi = np.where(blocked[:, None, None], 0, heard(board, places, rng))
        for axis in (0, 1):
            for wall in (-5.0, HALL_M + 5.0):
                image = places.copy()
                image[:, axis] = 2 * wall - image[:, axis]
                csi = csi + 0.5 * heard(board, image, rng)
        frames.append(csi.astype(np.complex64))
    receivers = [Receiver(board) for board in boards]
    return [r.site for r in receivers], [r.prepared(f) for r, f in zip(receivers, frames, strict=True)]


def test_blocked_ues_of_a_hall_are_pulled_back() -> None:
    rng = np.random.default_rng(8)
    places = np.column_stack([rng.uniform(3, HALL_M - 3, (400, 2)), np.full(400, 1.5)])
    blocked = rng.random(400) < 0.15
    sites, frames = _echoing(blocked, places)
    fused = Fuser(sites, Area((0.0, 0.0), (HALL_M, HALL_M), 1.5)).locate(frames)
    own = fused.position[:, :2]
    neighbours = graph(Profiler(sites).of(frames), own, fused.outlier <= np.median(fused.outlier))
    tops, scores = fused.tops[:, :, :2], fused.top_scores
    found = refine(neighbours, own, np.zeros((400, 2, 2)), fused.outlier, tops, scores)
    before = np.linalg.norm(own - places[:, :2], axis=1)
    after = np.linalg.norm(found.place - places[:, :2], axis=1)
    assert np.quantile(before, 0.9) > 5
    assert np.quantile(after, 0.9) < 0.7 * np.quantile(before, 0.9)
    assert np.median(after) <= np.median(before)


def test_profiles_know_neither_phase_nor_power_nor_what_a_clock_adds() -> None:
    rng = np.random.default_rng(9)
    board = hall()[0]
    site = Receiver(board).site
    csi = heard(board, np.array([[10.0, 12.0, 1.5]]), rng)
    later = csi * np.exp(-2j * np.pi * np.arange(csi.shape[2]) * 7.25 / csi.shape[2])
    same = Profiler([site])
    np.testing.assert_allclose(same.of([csi * 3e-3j]), same.of([csi]), atol=1e-4)
    assert np.linalg.norm(same.of([later]) - same.of([csi])) > 0.5
    for clock in ("offset", "own"):
        shifted = Profiler([site], clock)
        np.testing.assert_allclose(shifted.of([later.astype(np.complex64)]), shifted.of([csi]), atol=2e-3)


def test_noise_has_no_profile() -> None:
    rng = np.random.default_rng(10)
    sites = [Receiver(board).site for board in hall()]
    shape = (20, 8, len(sites[0].tones_hz))
    frames = [
        (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64) for _ in sites
    ]
    assert not Profiler(sites).of(frames).any()


def test_streets() -> None:
    if not STREET.exists():
        pytest.skip(f"{STREET.name} of the ray-traced channels is not on this machine")
    with np.load(STREET) as z:
        iq = z["iq"].astype(np.float32)
        h = (iq[..., 0] + 1j * iq[..., 1]) * z["iq_scale"][:, :, None, None]
        sites = [Site(f"{b}", z["elements"][b], z["array_R"][b][:, 0], z["freqs"]) for b in range(4)]
        truth, edges = z["position"].astype(np.float64), z["area"]
    rng = np.random.default_rng(21)
    noise = np.sqrt((np.abs(h) ** 2).mean(axis=(2, 3)).max(axis=1) / 20)[:, None, None, None]
    h = h + noise * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
    frames = [np.ascontiguousarray(h[:, b], np.complex64) for b in range(4)]
    fused = Fuser(sites, Area((edges[0], edges[2]), (edges[1], edges[3]), float(truth[0, 2]))).locate(frames)
    own = fused.position[:, :2]
    neighbours = graph(Profiler(sites).of(frames), own, fused.outlier <= np.median(fused.outlier))
    zero = np.zeros((len(own), 2, 2))
    found = refine(neighbours, own, zero, fused.outlier, fused.tops[:, :, :2], fused.top_scores)
    before = np.linalg.norm(own - truth[:, :2], axis=1)
    after = np.linalg.norm(found.place - truth[:, :2], axis=1)
    assert np.quantile(after, 0.9) < 0.85 * np.quantile(before, 0.9)
    assert np.median(after) < np.median(before) + 0.005
