"""One line array and UEs that move: the live track beside single frames and averages."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import pytest

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks import tracks
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions

OPTIONS = argparse.Namespace(ues=8, frames=40, seed=5)


@pytest.fixture
def array() -> ArrayGeometry:
    return ArraySettings(height_m=8.5, subcarrier_spacing_hz=312500.0).geometry()


@pytest.mark.parametrize(
    ("channel", "speed", "rate"), [("los", 10.0, 2.0), ("los", 30.0, 10.0), ("qnlos", 10.0, 10.0)]
)
def test_the_track_errs_less_than_single_frames(
    array: ArrayGeometry, channel: str, speed: float, rate: float
) -> None:
    blocks = tracks.moving(array, channel, speed, rate, OPTIONS)
    tracked = tracks.errors(array, tracks.tracker(array, speed), blocks)
    single = tracks.errors(array, tracks.average(array, 1), blocks)
    assert np.median(tracked) < np.median(single)
    assert tracked.mean() < single.mean()
    assert tracked.max() < 150


def test_fast_ues_that_are_seldom_heard_are_not_lost(array: ArrayGeometry) -> None:
    blocks = tracks.moving(array, "qnlos", 30.0, 2.0, OPTIONS)
    tracked = tracks.errors(array, tracks.tracker(array, 30.0), blocks)
    assert np.median(tracked) < 6
    assert tracked.mean() < 20


def test_what_is_dead_does_not_count(array: ArrayGeometry) -> None:
    blocks = tracks.moving(array, "los", 1.5, 10.0, OPTIONS)
    broken = replace(array, dead_antennas=(3, 17), dead_tones=(0, 31))
    for block in blocks:
        block.csi[:, 3] = 100
        block.csi[:, :, 31] = 100
    estimator = FusedEstimator([broken], FusionOptions(area_m=tracks.AREA_M), TrackingOptions(motion="walk"))
    found = tracks.errors(array, estimator, blocks)
    assert np.median(found) < 0.6
    spectrum = estimator.spectrum(0)
    assert spectrum is not None
    assert len(spectrum["arrays"]) == 1
