"""Soft fusion against what is known of single waves: exactness, Cramér-Rao, clocks, dead arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from chachart.node.estimation.fusion.area import Area
from chachart.node.estimation.fusion.fuser import Fuser
from chachart.node.estimation.fusion.site import Site

from .conftest import LIGHT, noisy, received

Positions = NDArray[np.float64]


def _errors(found: NDArray[Any], truth: Positions) -> NDArray[Any]:
    return np.linalg.norm(found - truth, axis=1)


def test_noise_free_waves_are_located_to_the_millimetre(
    sites: list[Site], area: Area, positions: Positions
) -> None:
    found = Fuser(sites, area).locate([received(site, positions) for site in sites])
    assert _errors(found.position, positions).max() < 5e-3
    assert (found.arrays == 4).all()
    assert found.outlier.max() < 0.05
    assert np.isnan(found.offset_m).all()


def test_errors_come_near_the_cramer_rao_bound_of_delays(
    sites: list[Site], area: Area, positions: Positions
) -> None:
    errors = []
    for seed in range(4):
        frames = [noisy(received(site, positions), 0.0, seed * 10 + i) for i, site in enumerate(sites)]
        errors.append(_errors(Fuser(sites, area).locate(frames).position, positions))
    per_delay = (
        LIGHT / (2 * np.pi * np.sqrt(np.var(sites[0].tones_hz))) / np.sqrt(2 * 8 * 64)
    )  # of one range, 0 dB, 512 samples
    information = np.zeros((len(positions), 2, 2))
    for site in sites:
        d = (positions - site.centre)[:, :2] / np.linalg.norm(positions - site.centre, axis=1)[:, None]
        information += np.einsum("ui,uj->uij", d, d) / per_delay**2
    bound = np.sqrt(np.trace(np.linalg.inv(information), axis1=1, axis2=2).mean())
    assert np.sqrt(np.mean(np.square(errors))) < 1.15 * bound


def test_an_offset_of_the_ues_clock_is_found_with_the_position(
    sites: list[Site], area: Area, positions: Positions
) -> None:
    offset = np.linspace(-60, 200, len(positions))
    found = Fuser(sites, area, "offset").locate([received(s, positions, 1.0, offset) for s in sites])
    assert np.median(_errors(found.position, positions)) < 0.02
    wrapped = (found.offset_m - offset + 192) % sites[0].unambiguous_m - 192
    assert np.median(np.abs(wrapped)) < 0.05


def test_clocks_that_know_nothing_of_each_other_leave_directions(
    sites: list[Site], area: Area, positions: Positions
) -> None:
    rng = np.random.default_rng(1)
    frames = [received(s, positions, 1.0, rng.uniform(0, 300, len(positions))) for s in sites]
    assert np.median(_errors(Fuser(sites, area, "own").locate(frames).position, positions)) < 0.1
    assert np.median(_errors(Fuser(sites, area, "shared").locate(frames).position, positions)) > 3


def test_a_dead_array_costs_only_its_share(sites: list[Site], area: Area, positions: Positions) -> None:
    frames = [received(site, positions) for site in sites]
    frames[1][:] = 0
    found = Fuser(sites, area).locate(frames)
    assert _errors(found.position, positions).max() < 0.01
    assert (found.arrays == 3).all()


def test_a_ue_that_nobody_hears_has_no_position(sites: list[Site], area: Area, positions: Positions) -> None:
    frames = [received(site, positions) for site in sites]
    for frame in frames:
        frame[3] = 0
    found = Fuser(sites, area).locate(frames)
    assert np.isnan(found.position[3]).all()
    assert np.isnan(found.covariance[3]).all()
    assert found.outlier[3] == 1
    assert found.arrays[3] == 0
    assert np.isfinite(np.delete(found.position, 3, axis=0)).all()


def test_an_array_that_hears_only_an_echo_is_outvoted(
    sites: list[Site], area: Area, positions: Positions
) -> None:
    elsewhere = positions + np.array([9.0, -7.0, 0.0])
    frames = [received(site, elsewhere if i == 2 else positions) for i, site in enumerate(sites)]
    errors = _errors(Fuser(sites, area).locate(frames).position, positions)
    assert np.median(errors) < 0.01
    assert errors.max() < 0.5


def test_heights_are_found_where_they_are_free(sites: list[Site], positions: Positions) -> None:
    positions = positions.copy()
    positions[:, 2] = np.linspace(0.5, 3.0, len(positions))
    fuser = Fuser(sites, Area((-20, -20), (20, 20), None, heights_m=(0.0, 3.5)))
    found = fuser.locate([received(site, positions) for site in sites])
    assert np.median(_errors(found.position, positions)) < 0.05


def test_ues_on_a_slope_are_found_on_it(sites: list[Site], positions: Positions) -> None:
    area = Area((-20, -20), (20, 20), 1.5, slope=(0.05, -0.02))
    positions = positions.copy()
    positions[:, 2] = 1.5 + positions[:, :2] @ [0.05, -0.02]
    found = Fuser(sites, area).locate([received(site, positions) for site in sites])
    assert _errors(found.position, positions).max() < 0.01


def test_a_known_neighbourhood_is_searched_as_well(
    sites: list[Site], area: Area, positions: Positions
) -> None:
    near = np.full((len(positions), 1, 3), np.nan)
    near[::2] = positions[::2, None] + 0.4
    found = Fuser(sites, area).locate([received(site, positions) for site in sites], near)
    assert found.tops.shape[1] == 6
    assert _errors(found.position, positions).max() < 5e-3


def test_positions_outside_an_outline_are_no_candidates(sites: list[Site], positions: Positions) -> None:
    area = Area((-20, -20), (20, 20), 1.5, outline=((-20, -20), (20, -20), (20, 20)))
    assert area.contains(np.array([[10.0, 0.0, 1.5], [-10.0, 0.0, 1.5]])).tolist() == [True, False]
    inside = area.contains(positions)
    found = Fuser(sites, area).locate([received(site, positions) for site in sites])
    assert _errors(found.position[inside], positions[inside]).max() < 5e-3
    assert 0 < inside.sum() < len(inside)


def test_mistakes_are_told(sites: list[Site], area: Area) -> None:
    with pytest.raises(ValueError, match="at least one array"):
        Fuser([], area)
    with pytest.raises(ValueError, match="lower to a higher corner"):
        Area((0, 0), (0, 5))
    with pytest.raises(ValueError, match="at least 3 corners"):
        Area((0, 0), (5, 5), outline=((0, 0), (1, 1)))
    with pytest.raises(ValueError, match="rising evenly"):
        Site("a", sites[0].elements, sites[0].normal, np.array([1e9, 2e9, 4e9]))
