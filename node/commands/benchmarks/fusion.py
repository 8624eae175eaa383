"""How many positions a second one core fuses from four boards round a hall, by UEs at once."""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.benchmarks.report import Table
from chachart.node.data import elements as layouts
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.options import Options

HALL_M = 40.0
TONES, BANDWIDTH_HZ, CARRIER_HZ = 64, 50e6, 3.5e9
SNR_DB = 10.0
WANTED = 20480
"""2048 UEs at 10 positions a second each."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--seconds", type=float, default=3.0, help="of each measurement (default: 3)")
    parser.add_argument("--batch", type=int, action="append", help="UEs at once (default: 1, 16, 64)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """A row for each number of UEs at once, without and with tracking."""
    table = Table(
        f"Four boards of 2 x 4 x {TONES}, {HALL_M:g} m x {HALL_M:g} m: positions a second of one core",
        ["UEs at once", "motion", "positions/s", "ms a position", f"cores for {WANTED}/s", "median error, m"],
    )
    boards = hall()
    for batch in arguments.batch or (1, 16, 64):
        for motion in ("off", "walk"):
            fusion = FusionOptions(area_m=(0.0, 0.0, HALL_M, HALL_M), height_m=1.5)
            tracking = TrackingOptions.model_validate({"motion": motion})
            estimator = FusedEstimator(boards, fusion, tracking, Options(max_ues=4096))
            rate, error = measured(estimator, boards, batch, arguments.seconds)
            table.add(batch, motion, round(rate), 1e3 / rate, round(WANTED / rate, 1), error)
    return [table]


def hall() -> list[ArrayGeometry]:
    """Boards in the middles of four walls, on one clock."""
    grid = layouts.grid(2, 4, SPEED_OF_LIGHT / CARRIER_HZ / 2)
    half = HALL_M / 2
    boards = []
    for name, at, normal in (
        ("north", (half, HALL_M), (0.0, -1.0, 0.0)),
        ("east", (HALL_M, half), (-1.0, 0.0, 0.0)),
        ("south", (half, 0.0), (0.0, 1.0, 0.0)),
        ("west", (0.0, half), (1.0, 0.0, 0.0)),
    ):
        right = np.cross([0.0, 0.0, 1.0], normal)
        pose: dict[str, Any] = {"position_m": (*at, 4.0), "axis": tuple(right.tolist()), "broadside": normal}
        band = TONES, CARRIER_HZ, BANDWIDTH_HZ / TONES
        boards.append(ArrayGeometry.of_elements(name, grid, *band, clock="hall", **pose))
    return boards


def measured(
    estimator: FusedEstimator, boards: list[ArrayGeometry], batch: int, seconds: float
) -> tuple[float, float]:
    """Positions a second, and their median error in metres."""
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(4, HALL_M - 4, (batch, 2)), np.full(batch, 1.5)])
    frames = [heard(board, places, rng) for board in boards]
    ue = np.arange(batch, dtype=np.uint64)
    errors, count, took, now_ns = [], 0, 0.0, 0
    while took < seconds:
        began = time.process_time()
        for board, csi in zip(boards, frames, strict=True):
            block = CsiBlock(board.name, 0, ue, np.full(batch, now_ns), csi)
            update = estimator.update(block)
        took += time.process_time() - began
        now_ns += 100_000_000
        count += batch
        off = np.column_stack([update.x, update.y]) - places[update.ue.astype(np.int64), :2]
        errors.append(np.hypot(*off.T))
    return count / took, float(np.median(np.concatenate(errors)))


def heard(
    board: ArrayGeometry, places: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.complex64]:
    """Spherical waves from `places` (U, 3) in noise, (U, N, S)."""
    away = np.linalg.norm(places[:, None] - board.element_positions(), axis=2)
    turns = away[:, :, None] * board.frequencies_hz / board.light_speed_m_s
    wave = np.exp(-2j * np.pi * (turns % 1)) / away[:, :, None]
    level = np.abs(wave).mean() * 10 ** (-SNR_DB / 20) / np.sqrt(2)
    noise = rng.standard_normal((2, *wave.shape)) * level
    return np.asarray(wave + noise[0] + 1j * noise[1], np.complex64)
