"""Boards, circles and elements in space: speed, errors over the Cramér-Rao bound, and ray-traced streets."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.timing import Timing
from chachart.node.commands.shared.cli import progress
from chachart.node.data.csi import CsiBlock
from chachart.node.data.elements import circle, grid
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import SPEED_OF_LIGHT, ArrayGeometry
from chachart.node.data.methods import RhoMethod, ThetaMethod
from chachart.node.estimation.bounds import information_scale
from chachart.node.estimation.directions.algebra import inverse
from chachart.node.estimation.directions.axis import manifold_of
from chachart.node.estimation.directions.manifold import compass
from chachart.node.estimation.directions.sphere import unit
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.options import JOINT, SPECTRAL

Floats = NDArray[np.float64]

CARRIER_HZ, SPACING_HZ = 3.5e9, 781_250.0
WAVE_M = SPEED_OF_LIGHT / CARRIER_HZ
SHAPES: dict[str, tuple[Floats, int]] = {
    "board 2 x 4": (grid(2, 4, WAVE_M / 2), 64),
    "board 8 x 8": (grid(8, 8, WAVE_M / 2), 32),
    "circle of 5": (circle(5, 0.33 * WAVE_M), 64),
    "circle of 16": (circle(16, WAVE_M), 64),
    "9 in space": (np.random.default_rng(7).uniform(-WAVE_M, WAVE_M, (9, 3)), 64),
}
"""Elements, and tones."""
SNRS_DB = (-10.0, 0.0, 10.0, 20.0)
METHODS: tuple[ThetaMethod, ...] = (*SPECTRAL, JOINT)
BLOCK, ERROR_BLOCK = 256, 32
STREET_SNR_DB = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench arrays`."""
    parser.add_argument("--ues", type=int, default=1024, help="UEs (default: %(default)s)")
    parser.add_argument(
        "--frames", type=int, default=20, help="of each UE, for errors (default: %(default)s)"
    )
    parser.add_argument("--runs", type=int, default=7, help="timed runs (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of directions and noise (default: %(default)s)")
    parser.add_argument(
        "--only", choices=("speed", "errors", "streets"), help="one of the three tables (default: all)"
    )
    parser.add_argument("--raytraced", type=Path, metavar="FILE.npz", help="ray-traced channels of a mast")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Time every array and method, then their errors."""
    if arguments.only == "streets" and arguments.raytraced is None:
        raise SetupError("--only streets needs --raytraced FILE.npz")
    only, tables = arguments.only, []
    if only in (None, "speed"):
        tables.append(_speed(arguments))
    if only in (None, "errors"):
        tables.append(_errors(arguments))
    if only in (None, "streets") and arguments.raytraced is not None:
        tables.append(_streets(arguments.raytraced, arguments.seed))
    return tables


def an_array(name: str, tones: int | None = None) -> ArrayGeometry:
    """One of `SHAPES`."""
    elements, usual = SHAPES[name]
    return ArrayGeometry.of_elements("bench", elements, tones or usual, CARRIER_HZ, SPACING_HZ)


def somewhere(name: str, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Azimuths and elevations that the array tells, away from its edges."""
    if name.startswith("board"):
        return rng.uniform(-0.8, 0.8, count), rng.uniform(-0.6, 0.6, count)
    low, high = (-1.0, 1.0) if name.endswith("space") else (-1.1, -0.5)
    return rng.uniform(-np.pi, np.pi, count), rng.uniform(low, high, count)


def plane_waves(array: ArrayGeometry, d: Floats, rho: Floats) -> NDArray[np.complex128]:
    """Channels (K, N_R, N_S) of plane waves from own directions d (K, 3) at rho (K,), amplitude 1."""
    steering = manifold_of(array).steering(d)
    delays = np.exp(1j * array.rho_phase * rho[:, None] * array.tone_numbers)
    return np.asarray(steering[:, :, None] * delays[:, None])


def noisy(clean: NDArray[np.complex128], snr_db: float, rng: np.random.Generator) -> NDArray[np.complex64]:
    """Frames with a phase of their own each, and noise."""
    turn = np.exp(2j * np.pi * rng.random((len(clean), 1, 1)))
    noise = rng.standard_normal((*clean.shape, 2)).view(np.complex128)[..., 0]
    frames: NDArray[np.complex64] = (clean * turn + noise * 10 ** (-snr_db / 20) / np.sqrt(2)).astype("c8")
    return frames


def _rho(method: ThetaMethod) -> RhoMethod:
    return JOINT if method == JOINT else "bartlett"


def _speed(arguments: argparse.Namespace) -> Table:
    table = Table(
        f"us a UE, {arguments.ues} UEs in blocks of {BLOCK}, 10 dB, both angles and delay off the grid",
        ["array", "tones", *METHODS],
    )
    rng = np.random.default_rng(arguments.seed)
    for name in SHAPES:
        array = an_array(name)
        d = unit(*somewhere(name, arguments.ues, rng))
        csi = noisy(plane_waves(array, d, rng.uniform(20, 300, arguments.ues)), 10.0, rng)
        blocks = [
            CsiBlock.of(csi[start : start + BLOCK], np.arange(start, min(start + BLOCK, len(csi))))
            for start in range(0, len(csi), BLOCK)
        ]
        cells = []
        for method in METHODS:
            estimator = ChartEstimator(array, theta=method, rho=_rho(method), averaging="mean")
            seconds = []
            for _ in range(arguments.runs + 1):
                begin = time.perf_counter()
                for block in blocks:
                    estimator.update(block)
                seconds.append(time.perf_counter() - begin)
            cells.append(Timing.of(seconds[1:]).scaled(1e6 / arguments.ues))
        table.add(name, array.subcarriers, *cells)
    return table


def _errors(arguments: argparse.Namespace) -> Table:
    methods: tuple[ThetaMethod, ...] = ("bartlett", "music", JOINT)
    table = Table(
        f"rms error over the Cramér-Rao bound, azimuth / elevation, {arguments.frames} frames of "
        f"{arguments.ues} UEs with 32 tones",
        ["array", "SNR, dB", *methods],
    )
    with progress("errors", len(SHAPES) * len(SNRS_DB)) as advance:
        for name in SHAPES:
            for snr_db in SNRS_DB:
                cells = [_over_bound(name, method, snr_db, arguments) for method in methods]
                table.add(
                    name, f"{snr_db:g}", *(f"{azimuth:.3f} / {elevation:.3f}" for azimuth, elevation in cells)
                )
                advance(1)
    table.notes = [f"each known to {1 / np.sqrt(2 * arguments.ues):.1%}"]
    return table


def _over_bound(
    name: str, method: ThetaMethod, snr_db: float, arguments: argparse.Namespace
) -> tuple[float, float]:
    """Of the bound for what the method sees: snapshots of the elements, or, joint, of elements and tones."""
    array, ues, frames = an_array(name, 32), arguments.ues, arguments.frames
    rng = np.random.default_rng([arguments.seed, round(snr_db) + 100])
    azimuth, elevation = somewhere(name, ues, rng)
    d = unit(azimuth, elevation)
    clean = plane_waves(array, d, rng.uniform(20, 300, ues))
    estimator = ChartEstimator(array, theta=method, rho=_rho(method), averaging="mean")
    found = []
    for start in range(0, ues, ERROR_BLOCK):
        ue = np.repeat(np.arange(start, min(start + ERROR_BLOCK, ues)), frames)
        chart = estimator.update(noisy(clean[ue], snr_db, rng), ue=ue)
        found.append(np.stack([chart["azimuth"], chart["elevation"]]))
    manifold = manifold_of(array)
    snr, together = 10 ** (snr_db / 10), array.subcarriers if method == JOINT else 1
    scale = information_scale(manifold.size, frames * array.subcarriers / together, snr * together)
    across, _, upwards = inverse(scale * manifold.information(d, np.stack(compass(d))))
    off = np.concatenate(found, axis=1) - np.stack([azimuth, elevation])
    turned = np.angle(np.exp(1j * off[0])) * np.cos(elevation)
    return float(np.sqrt(np.mean(turned**2 / across))), float(np.sqrt(np.mean(off[1] ** 2 / upwards)))


def _streets(path: Path, seed: int) -> Table:
    try:
        channels: Any = np.load(path)
        names = channels["array_names"].tolist()
    except (OSError, EOFError, KeyError, ValueError) as error:
        raise SetupError(f"{path} does not hold ray-traced channels of a mast: {error}") from None
    table = Table(
        f"{path.name}: median error of azimuth / elevation, degrees, one frame at {STREET_SNR_DB:g} dB",
        ["array", "UEs", "bartlett", "music", JOINT, "joint, paths = 1"],
    )
    for number, name in enumerate(names):
        array, csi, truth = _street(channels, number, name, seed)
        cells = []
        compared: tuple[tuple[ThetaMethod, int], ...] = (
            ("bartlett", 1),
            ("music", 1),
            (JOINT, 2),
            (JOINT, 1),
        )
        for method, paths in compared:
            estimator = ChartEstimator(array, theta=method, rho=_rho(method), paths=paths, rho_max_m=380.0)
            chart = estimator.update(csi, ue=np.arange(len(csi)))
            azimuth = np.abs(np.angle(np.exp(1j * (chart["azimuth"] - truth[0]))))
            elevation = np.abs(np.abs(chart["elevation"]) - np.abs(truth[1]))
            cells.append(" / ".join(f"{np.degrees(np.median(off)):.3f}" for off in (azimuth, elevation)))
        table.add(name, len(csi), *cells)
    table.notes = ["elevations without their sign: circles see below and above alike"]
    return table


def _street(
    channels: Any, number: int, name: str, seed: int
) -> tuple[ArrayGeometry, NDArray[np.complex64], tuple[Floats, Floats]]:
    """The array, frames of the UEs in its sight, and their azimuths and elevations."""
    normal, right, up = channels["array_R"][number].T
    place = channels["array_position"][number]
    array = ArrayGeometry.of_elements(
        name,
        (channels[f"elements_{name}"] - place) @ np.stack([right, up, normal], axis=1),
        len(channels["freqs"]),
        float(channels["freqs"][0]),
        float(np.diff(channels["freqs"]).mean()),
        position_m=tuple(place),
        axis=tuple(right),
        broadside=tuple(normal),
    )
    azimuth, elevation = channels["azimuth"][:, number], channels["elevation"][:, number]
    seen = channels[f"{name if name.startswith('ura') else 'uca'}_los"].astype(bool)
    if array.facing is not None and array.facing[2] > 0.5:
        seen &= np.abs(azimuth) < np.pi / 2
    iq = channels[f"iq_{name}"][seen].astype(np.float64)
    h = iq[..., 0] + 1j * iq[..., 1]
    h /= np.sqrt((np.abs(h) ** 2).mean(axis=(1, 2), keepdims=True))
    return array, noisy(h, STREET_SNR_DB, np.random.default_rng(seed)), (azimuth[seen], elevation[seen])
