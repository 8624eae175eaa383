"""Truth: errors against the deviations that were told, with and without a direct path, over several draws."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.reproduction import runs, scenario
from chachart.node.commands.reproduction.paper import Pair
from chachart.node.commands.shared.cli import progress
from chachart.node.commands.shared.scenes import CHANNELS, data, pairs
from chachart.node.data.chart import ChartUpdate
from chachart.node.estimation.quality import neighbourhoods

Floats = NDArray[np.float64]

PAIRS = "bartlett/bartlett,mvdr/mvdr,music/music,joint/joint,bartlett/lr,bartlett/isq"
NINETY_FIVE = 1.96
"""Deviations that 95 % of normal errors keep within."""
FAR_OFF_M = 20.0
NEIGHBOURS = 0.05
COLUMNS = (
    "theta / rho",
    "variance theta, rho",
    "within 95 % theta, rho",
    f"AUC > {FAR_OFF_M:g} m",
    "direct told (found)",
    "median, 90 % m",
    "TW, CT",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench truth`."""
    parser.add_argument("--channels", default=",".join(CHANNELS), help="(%(default)s)")
    parser.add_argument("--pairs", type=pairs, default=pairs(PAIRS), help=f"({PAIRS})")
    parser.add_argument("--bandwidth", type=float, default=10e6, metavar="HZ", help="(%(default)g)")
    parser.add_argument("--snr-db", type=float, default=0.0, metavar="DB", help="(%(default)g)")
    parser.add_argument("--ues", type=int, default=2048, help="(%(default)s)")
    parser.add_argument("--frames", type=int, default=10, help="(%(default)s)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4], help="(0 1 2 3 4)")
    parser.add_argument("--phase", choices=("auto", "steady", "random"), default="auto", help="(%(default)s)")
    parser.add_argument(
        "--no-positions",
        action="store_true",
        help="let no UE's position be known, instead of the first 256's",
    )
    parser.add_argument(
        "--data", action="extend", nargs="+", type=data, default=[], metavar="CHANNEL=FILE.mcap",
        help="recorded channels; seeds are then of the noise",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> list[Table]:
    """One table a channel: means over the seeds."""
    recorded = dict(arguments.data)
    channels = arguments.channels.split(",")
    tables = []
    with progress("draws", len(channels) * len(arguments.seeds)) as done:
        for channel in channels:
            found: dict[Pair, list[Floats]] = {pair: [] for pair in arguments.pairs}
            for scene in _scenes(channel, recorded.get(channel), arguments, done):
                for pair in arguments.pairs:
                    chart, _ = runs.estimate(
                        scene, pair, {"phase": arguments.phase}, positions=not arguments.no_positions
                    )
                    found[pair].append(judged(scene, chart))
            tables.append(_table(channel, arguments, found))
    return tables


def judged(scene: scenario.Scene, chart: ChartUpdate) -> Floats:
    """Eleven figures: variances, coverages, AUC, directness told and found, errors in metres, TW and CT."""
    theta, rho = scene.array.theta_rho(scene.position)
    off_theta, off_rho = chart.theta - theta, chart.rho - rho
    z = np.stack([off_theta / chart.theta_std, off_rho / chart.rho_std])
    xy = np.stack([chart.x, chart.y], axis=1)
    error = np.linalg.norm(xy - scene.truth, axis=1)
    told = np.hypot(chart.rho_std, chart.rho * chart.theta_std)
    array = scene.array
    cells = (2 * np.pi / array.antennas / array.theta_phase, array.unambiguous_rho_m / array.subcarriers)
    direct = (np.abs(np.cos(chart.theta) - np.cos(theta)) < cells[0] / 2) & (np.abs(off_rho) < cells[1] / 2)
    near = neighbourhoods(scene.truth, xy, max(round(NEIGHBOURS * len(xy)), 1))
    return np.array(
        [
            *np.mean(z**2, axis=1),
            *np.mean(np.abs(z) < NINETY_FIVE, axis=1),
            area_under_curve(told, error > FAR_OFF_M),
            np.mean(chart["p_direct"]),
            np.mean(direct),
            np.median(error),
            np.percentile(error, 90),
            near.tw,
            near.ct,
        ]
    )


def area_under_curve(score: Floats, bad: NDArray[np.bool_]) -> float:
    """Probability that a bad one has the higher score; NaN where all are bad or none is.

    >>> area_under_curve(np.array([1.0, 2.0, 3.0]), np.array([False, False, True]))
    1.0
    """
    count = int(bad.sum())
    if count in (0, len(bad)):
        return float("nan")
    rank = np.argsort(np.argsort(score, kind="stable"), kind="stable") + 1
    return float((rank[bad].sum() - count * (count + 1) / 2) / (count * (len(bad) - count)))


def _scenes(
    channel: Any, recording: Any, arguments: argparse.Namespace, done: Callable[[int], None]
) -> Iterator[scenario.Scene]:
    for seed in arguments.seeds:
        draw = (arguments.ues, arguments.frames, arguments.snr_db, seed)
        if recording is None:
            yield scenario.modelled(channel, scenario.scenario_array(arguments.bandwidth), *draw)
        else:
            yield scenario.recorded(channel, recording, *draw)
        done(1)


def _table(channel: str, arguments: argparse.Namespace, found: dict[Pair, list[Floats]]) -> Table:
    title = (
        f"{channel}, {arguments.bandwidth / 1e6:g} MHz, {arguments.snr_db:g} dB, {len(arguments.seeds)} draws"
    )
    table = Table(title, list(COLUMNS))
    for pair, figures in found.items():
        m = np.mean(figures, axis=0)
        table.add(
            runs.display(pair),
            f"{m[0]:.2f}, {m[1]:.2f}",
            f"{m[2]:.1%}, {m[3]:.1%}",
            f"{m[4]:.3f}",
            f"{m[5]:.3f} ({m[6]:.3f})",
            f"{m[7]:.2f}, {m[8]:.2f}",
            f"{m[9]:.4f}, {m[10]:.4f}",
        )
    return table
