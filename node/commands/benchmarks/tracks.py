"""UEs that move before one line array: the live track beside averages over fixed numbers of frames."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.shared.cli import progress
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.options import Options
from chachart.node.estimation.tracking.motion import Motion
from chachart.sources.simulator import Simulator, SimulatorSettings

CHANNELS = ("los", "qlos", "qnlos")
SPEEDS = (1.5, 10.0, 30.0)
RATES = (2.0, 10.0, 100.0)
MEMORIES = (1, 4, 16)
WARM_UP = 10
"""Frames of each UE that do not count: every method has to get going."""
AREA_M = (100.0, -500.0, 600.0, 500.0)
STAYS_M, MOST_FRAMES = 0.6, 8
"""A track's estimates take the frames of so far a walk, but no more than that."""
WALKING = 2.0
"""Up to so many m/s `walk` is what suits, beyond it `drive`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--ues", type=int, default=12, help="UEs of each cell (default: 12)")
    parser.add_argument("--frames", type=int, default=60, help="frames of each UE (default: 60)")
    parser.add_argument("--seed", type=int, default=0, help="of scenario, walks and noise (default: 0)")
    parser.add_argument("--channel", action="append", choices=CHANNELS, help="only that one; may be repeated")
    parser.add_argument("--speed", type=float, action="append", help="m/s, instead of 1.5, 10 and 30")
    parser.add_argument("--rate", type=float, action="append", help="frames/s a UE, instead of 2, 10, 100")


def run(arguments: argparse.Namespace) -> list[Table]:
    """A row for each channel, speed and rate: median and 90 % error in metres, mean of the track's too."""
    array = ArraySettings(height_m=8.5, subcarrier_spacing_hz=312500.0).geometry()
    columns = [f"memory {m}" for m in MEMORIES]
    table = Table(
        f"Errors of {arguments.ues} UEs x {arguments.frames - WARM_UP} frames, median / 90 % in m; 32 x 32, "
        f"10 MHz, 0 dB, seed {arguments.seed}",
        ["channel", "m/s", "frames/s", "live track", "mean", "of frames", *columns],
    )
    cells = [
        (channel, speed, rate)
        for channel in arguments.channel or CHANNELS
        for speed in arguments.speed or SPEEDS
        for rate in arguments.rate or RATES
    ]
    with progress("cells", len(cells)) as done:
        for channel, speed, rate in cells:
            blocks = moving(array, channel, speed, rate, arguments)
            frames = frames_a_position(speed, rate)
            tracked = errors(array, tracker(array, speed, frames), blocks)
            fixed = [_figures(errors(array, average(array, memory), blocks)) for memory in MEMORIES]
            cell = [channel, f"{speed:g}", f"{rate:g}"]
            table.add(*cell, _figures(tracked), f"{tracked.mean():.2f}", frames, *fixed)
            done(1)
    return [table]


def moving(
    array: ArrayGeometry, channel: str, speed: float, rate: float, arguments: argparse.Namespace
) -> list[CsiBlock]:
    """Frames of UEs that go from point to random point, one block a round."""
    ues = arguments.ues
    clock = _Clock()
    settings = SimulatorSettings.model_validate(
        {
            "type": "simulator",
            "layout": "uniform",
            "ues": ues,
            "channel": channel,
            "motion": "waypoint",
            "speed_m_s": speed,
            "frame_rate_hz": rate * ues,
            "frames": ues * arguments.frames,
            "block_frames": ues,
            "seed": arguments.seed,
        }
    )
    blocks: list[CsiBlock] = []
    with Simulator(settings, array, clock.now, clock.sleep) as source:
        while sum(map(len, blocks)) < ues * arguments.frames:
            block = source.recv(1e9)
            if block is not None:
                blocks.append(block)
    whole = CsiBlock.concatenate(blocks)
    return [whole.cut(start, start + ues) for start in range(0, len(whole), ues)]


def errors(array: ArrayGeometry, estimator: Any, blocks: Sequence[CsiBlock]) -> NDArray[np.float64]:
    """How far off each row is, in metres, behind the first `WARM_UP` blocks."""
    found = []
    for number, block in enumerate(blocks):
        update: ChartUpdate = estimator.update(block)
        if number >= WARM_UP and len(update):
            assert block.position is not None
            order = np.argsort(block.ue)
            which = order[np.searchsorted(block.ue[order], update.ue)]
            truth = update.with_columns(position=block.position[which])
            x, y = truth.truth_of(array)
            found.append(np.hypot(truth.x - x, truth.y - y))
    return np.concatenate(found)


def frames_a_position(speed: float, rate: float) -> int:
    """Frames that a UE of that speed sends while it stays where it is, as far as that matters."""
    return int(np.clip(STAYS_M * rate / speed, 1, MOST_FRAMES))


def tracker(array: ArrayGeometry, speed: float, frames: int = 1) -> FusedEstimator:
    """What follows UEs of that speed, from estimates of so many frames."""
    motion: Motion = "walk" if speed <= WALKING else "drive"
    options = Options(max_ues=4096, memory_frames=frames)
    return FusedEstimator([array], FusionOptions(area_m=AREA_M), TrackingOptions(motion=motion), options)


def average(array: ArrayGeometry, memory: int) -> ChartEstimator:
    """What averages over so many frames."""
    return ChartEstimator(array, theta="joint", rho="joint", averaging="exponential", memory_frames=memory)


def _figures(error: NDArray[np.float64]) -> str:
    return f"{np.median(error):.2f} / {np.percentile(error, 90):.2f}"


class _Clock:
    """Time that passes when somebody sleeps: frames come as fast as they can be made."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def sleep(self, seconds: float) -> None:
        self._now += seconds
