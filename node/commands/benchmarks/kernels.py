"""Kernels: time a UE of each method on each manifold and of each pair, one thread, in blocks of frames."""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks import textbook
from chachart.node.commands.benchmarks.report import Cell, Table
from chachart.node.commands.benchmarks.timing import Timing
from chachart.node.commands.shared.cli import progress
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import RhoMethod, ThetaMethod
from chachart.node.estimation.covariance import Bank, Weights
from chachart.node.estimation.direct_path import DirectPath
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.joint import JointLocator
from chachart.node.estimation.manifold import Search
from chachart.node.estimation.options import JOINT, SPECTRAL
from chachart.node.estimation.separate import SeparateLocator
from chachart.sources.scenario.channel import channels
from chachart.sources.scenario.layout import place

PAIRS: tuple[tuple[ThetaMethod, RhoMethod], ...] = (
    *((method, method) for method in SPECTRAL),
    (JOINT, JOINT),
    ("bartlett", "music"),
    ("bartlett", "isq"),
    ("bartlett", "lr"),
    ("bartlett", "auto"),
)
TEXTBOOK_UES = 96
LITERAL_UES = 8
STAGES: dict[str, tuple[Callable[..., Any], ...]] = {
    "covariance": (SeparateLocator.features, JointLocator.features, Bank.add, Weights.add),
    "search": (Search.extremum, DirectPath.find),
}
"""Functions whose time, with all that they call, is that of a stage; what is left of
the whole is the map from covariance to spectrum."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench kernels`."""
    parser.add_argument("--ues", type=int, default=2048, help="UEs (default: %(default)s)")
    parser.add_argument("--antennas", type=int, default=32, help="default: %(default)s")
    parser.add_argument("--subcarriers", type=int, default=32, help="default: %(default)s")
    parser.add_argument(
        "--block",
        type=int,
        default=256,
        help="frames a block; a busy worker takes so many (default: %(default)s)",
    )
    parser.add_argument("--order", type=int, default=1, help="signal order (default: %(default)s)")
    parser.add_argument("--runs", type=int, default=7, help="timed runs (default: %(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Time every pair in turn, then the textbook's."""
    array = ArraySettings(
        antennas=arguments.antennas, subcarriers=arguments.subcarriers, subcarrier_spacing_hz=312500.0
    ).geometry()
    blocks = noisy_blocks(array, arguments.ues, arguments.block)
    estimators = {
        pair: ChartEstimator(
            array, theta=pair[0], rho=pair[1], averaging="mean", signal_order=arguments.order
        )
        for pair in PAIRS
    }
    for pair in estimators:
        _update_all(estimators[pair], blocks)  # every UE is known, and LR is trained, before time counts
    seconds: dict[Any, list[float]] = {pair: [] for pair in PAIRS}
    copy: list[float] = []
    with progress("timing", arguments.runs) as done:
        for _ in range(arguments.runs):
            copy.append(_timed(lambda: [block.csi.copy() for block in blocks]))
            for pair, estimator in estimators.items():
                seconds[pair].append(_timed(partial(_update_all, estimator, blocks)))
            done(1)
    per_ue = 1e6 / arguments.ues
    copied = Timing.of(copy).scaled(per_ue)
    table = Table(
        f"estimators, {arguments.ues} UEs of {array.antennas} x {array.subcarriers} complex64, "
        f"both coordinates refined off the grid, signal order {arguments.order}",
        ["theta / rho", "us a UE", "x copy", "UE by UE, us", "x faster", "and angle by angle", "x faster "],
    )
    stages = Table("where the time goes", ["theta / rho", *STAGES, "spectrum and the rest"])
    csi = np.concatenate([block.csi for block in blocks])
    for pair, estimator in estimators.items():
        timing = Timing.of(seconds[pair]).scaled(per_ue)
        cells: list[Cell] = [" / ".join(pair), timing, timing.median / copied.median]
        for scan, ues in ((textbook.scan_at_once, TEXTBOOK_UES), (textbook.scan_one_by_one, LITERAL_UES)):
            reference = textbook_time(csi[:ues], array, pair, arguments.order, scan)
            cells += [reference, None if reference is None else reference / timing.median]
        table.add(*cells)
        shares = stage_shares(partial(_update_all, estimator, blocks))
        stages.add(" / ".join(pair), *(f"{share:.0%}" for share in (*shares, 1 - sum(shares))))
    table.notes = [
        f"copying the input once: {copied} us a UE",
        "UE by UE: as textbooks have it, in numpy, on a grid of 1 degree, and of 1 m up to 959 m",
    ]
    stages.notes = ["told by a profiler, which makes small calls look dearer than they are"]
    return [table, stages]


def noisy_blocks(
    array: ArrayGeometry, ues: int, block_frames: int, snr_db: float = 0.0, seed: int = 0
) -> list[CsiBlock]:
    """One frame of each UE of the vip scenario in line of sight, with noise, in blocks."""
    position = place("vip", ues, array)
    csi = channels("los", position, array)
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((*csi.shape, 2), np.float32).view(np.complex64)[..., 0]
    csi += noise * np.float32(np.sqrt(0.5 * 10 ** (-snr_db / 10)))
    return [
        CsiBlock(
            array.name,
            start,
            np.arange(start, min(start + block_frames, ues), dtype=np.uint64),
            np.full(min(block_frames, ues - start), 1, np.int64),
            csi[start : start + block_frames].copy(),
            position[start : start + block_frames].astype(np.float32),
        )
        for start in range(0, ues, block_frames)
    ]


def textbook_time(
    csi: NDArray[np.complex64], array: ArrayGeometry, pair: tuple[str, str], order: int, scan: textbook.Scan
) -> float | None:
    """Microseconds a UE of the textbook's loop; None for methods that it does not have."""
    if not set(pair) <= set(textbook.METHODS):
        return None
    theta = np.radians(np.arange(0.0, 181.0))
    rho = np.arange(0.0, min(1000.0, array.unambiguous_rho_m))
    tables = (
        _steering(array.antennas, array.theta_phase * np.cos(theta)),
        _steering(array.subcarriers, array.rho_phase * rho),
    )
    runs = [_timed(lambda: textbook.locate(csi, pair, tables, order, scan)) for _ in range(3)]
    return Timing.of(runs).median / len(csi) * 1e6


def stage_shares(call: Callable[[], Any]) -> list[float]:
    """Share of each of `STAGES` in a call's time."""
    profile = cProfile.Profile()
    profile.runcall(call)
    stats: dict[tuple[str, int, str], Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    total = max(entry[3] for entry in stats.values())
    shares = []
    for functions in STAGES.values():
        codes = [function.__code__ for function in functions]
        places = [(code.co_filename, code.co_firstlineno, code.co_name) for code in codes]
        shares.append(sum(stats[place][3] for place in places if place in stats) / total)
    return shares


def _update_all(estimator: ChartEstimator, blocks: list[CsiBlock]) -> None:
    for block in blocks:
        estimator.update(block)


def _steering(size: int, u: NDArray[np.float64]) -> NDArray[np.complex128]:
    table: NDArray[np.complex128] = np.exp(1j * np.arange(size)[:, None] * u)
    return table


def _timed(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start
