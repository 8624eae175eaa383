import numpy as np
import pytest

from chachart.sources.scenario.clusters import ENDS, OFFSETS, Draws, frame, scale, unit_vectors
from chachart.sources.scenario.large_scale import QLOS, QNLOS, LargeScaleFields

UES = 500


@pytest.fixture(params=[QLOS, QNLOS], ids=["qlos", "qnlos"])
def clustered(request):
    rng = np.random.default_rng(7)
    draws = Draws.draw(request.param, UES, rng)
    position = rng.uniform(-500, 500, (UES, 2))
    large = LargeScaleFields(request.param, rng).at(position, np.full(UES, 300.0))
    return draws, large, scale(draws, large), request.param


def spread(power, value):
    mean = np.sum(power * value, axis=1)
    return np.sqrt(np.sum(power * value**2, axis=1) - mean**2)


def test_powers_add_up_to_one_and_split_by_the_rician_factor(clustered):
    _, large, clusters, statistics = clustered
    assert clusters.power.shape == (UES, statistics.clusters - 1)
    np.testing.assert_allclose(clusters.direct + clusters.power.sum(axis=1), 1)
    np.testing.assert_allclose(clusters.direct / clusters.power.sum(axis=1), large.rice)
    assert clusters.power.min() > 0


def test_delays_have_the_delay_spread_and_follow_the_direct_path(clustered):
    _, large, clusters, _ = clustered
    assert clusters.delay_s.min() >= 0
    np.testing.assert_allclose(spread(clusters.power, clusters.delay_s), large.delay_spread_s)


def test_angles_have_their_spreads_unless_that_stretches_them_too_far(clustered):
    draws, large, clusters, _ = clustered
    for i, (end, limit) in enumerate(zip(ENDS, (3.0, 3.0, 1.5, 1.5), strict=True)):
        raw = spread(clusters.power, draws.angle[..., i])
        wanted = np.minimum(getattr(large, end), limit * raw)
        np.testing.assert_allclose(spread(clusters.power, clusters.angle[..., i]), wanted)
        assert np.mean(wanted < getattr(large, end)) < 0.5


def test_stronger_clusters_come_earlier_and_from_nearer_the_direct_path(clustered):
    draws, _, clusters, _ = clustered
    strong = clusters.power > np.median(clusters.power, axis=1, keepdims=True)
    assert draws.delay[strong].mean() < draws.delay[~strong].mean()
    assert np.abs(draws.angle[strong]).mean() < np.abs(draws.angle[~strong]).mean()


def test_sub_paths_have_every_offset_once_and_unit_spread(clustered):
    draws = clustered[0]
    assert np.sqrt(np.mean(OFFSETS**2)) == pytest.approx(1.0, abs=0.01)
    np.testing.assert_array_equal(
        np.sort(draws.order, axis=-1)[..., :], np.broadcast_to(np.arange(20), draws.order.shape)
    )
    same = np.mean(draws.order[0] == draws.order[2])
    assert same == pytest.approx(1 / 20, abs=0.01)


def test_frames_are_orthonormal_with_x_ahead_and_y_level():
    rng = np.random.default_rng(8)
    direction = rng.standard_normal((50, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[0] = [0.0, 0.0, 1.0]
    axes = frame(direction)
    np.testing.assert_allclose(
        axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(axes), 1)
    np.testing.assert_array_equal(axes[:, 0], direction)
    np.testing.assert_array_equal(axes[:, 1, 2], 0)


def test_elevations_beyond_the_pole_are_mirrored():
    np.testing.assert_allclose(unit_vectors(0.2, np.pi / 2 + 0.3), unit_vectors(0.2 + np.pi, np.pi / 2 - 0.3))
