"""Draws of the simulator's channels: what methods estimate on them, the evidence, and the errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chachart.config.settings import ArraySettings
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.covariance import Grouping
from chachart.node.estimation.joint import JointLocator
from chachart.node.estimation.locator import Columns, Locator
from chachart.node.estimation.options import JOINT, SPECTRAL, Keywords, Options
from chachart.node.estimation.separate import SeparateLocator
from chachart.sources.scenario.channel import ChannelName, channels
from chachart.sources.scenario.layout import place

Floats = NDArray[np.float64]

CHANNELS: Final[tuple[ChannelName, ...]] = ("los", "qlos", "qnlos")
SHARE: Final = {"los": 0.3, "qlos": 0.3, "qnlos": 0.4}
BANDWIDTHS_HZ: Final = (312.5e3, 1e6, 3e6, 10e6, 10e6, 10e6, 10e6, 40e6)
SIZES: Final = ((32, 32), (32, 32), (32, 32), (8, 32), (16, 16), (16, 64))
SNRS_DB: Final = (-10.0, -5.0, 0.0, 0.0, 0.0, 10.0, 20.0)
FRAMES: Final = (1, 4, 10)
BLOCK_UES: Final = 64
METHODS: Final = (*SPECTRAL, JOINT)
RANGE_BANDWIDTHS_HZ: Final = (312.5e3, 312.5e3, 312.5e3, 312.5e3, 1e6, 1e6, 3e6, 3e6, 10e6, 10e6)
"""For networks that correct ranges: most is to be won where the band is narrow."""
RANGE_SIZES: Final = ((32, 32), (32, 32), (32, 32), (32, 32), (8, 32), (16, 16), (32, 4), (32, 10), (16, 64))
FARTHEST_M: Final = 720.0
"""UEs are up to so far away: ranges that repeat earlier cannot be told."""


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """One world: which channels, of which array, how noisy.

    Attributes
    ----------
    channel, array, snr_db, frames, ues, seed
        As for `chachart reproduce`.
    """

    channel: ChannelName
    array: ArrayGeometry
    snr_db: float
    frames: int
    ues: int
    seed: int

    @property
    def cells(self) -> tuple[float, float]:
        """Resolution cells: of the cosine of theta, and of rho in metres."""
        a = self.array
        angle = 2 * np.pi / a.antennas / a.theta_phase
        return angle, a.light_speed_m_s / (a.subcarriers * a.subcarrier_spacing_hz)


def drawn(
    count: int,
    ues: int,
    seed: int,
    sizes: tuple[tuple[int, int], ...] = SIZES,
    bandwidths_hz: tuple[float, ...] = BANDWIDTHS_HZ,
) -> Iterator[Draw]:
    """`count` worlds, each with arrays, bands, SNR and channels drawn at random."""
    rng = np.random.default_rng([seed, 7])
    for n in range(count):
        antennas, subcarriers = sizes[rng.integers(len(sizes))]
        array = ArraySettings(
            antennas=antennas,
            subcarriers=subcarriers,
            subcarrier_spacing_hz=float(rng.choice(bandwidths_hz)) / subcarriers,
        ).geometry()
        channel = CHANNELS[rng.choice(len(CHANNELS), p=[SHARE[name] for name in CHANNELS])]
        yield Draw(channel, array, float(rng.choice(SNRS_DB)), int(rng.choice(FRAMES)), ues, 1000 * seed + n)


def world(draw: Draw) -> tuple[NDArray[np.complex64], Floats, Floats]:
    """Noise-free channels (U, N_R, N_S), and the true theta and rho (U,) of its UEs."""
    position = place("uniform", draw.ues, draw.array, draw.seed)
    theta, rho = draw.array.theta_rho(position)
    return channels(draw.channel, position, draw.array, draw.seed), theta, rho


def located(draw: Draw, csi: NDArray[np.complex64], method: str) -> Columns:
    """What a method on both axes says of the channels (U, N_R, N_S) with noise, and the evidence."""
    options = Options.of(**_keywords(method))
    make = JointLocator if method == JOINT else SeparateLocator
    locator: Locator = make(draw.array, options)
    locator.resize(draw.ues)
    rng = np.random.default_rng([draw.seed, 8])
    amplitude = np.float32(np.sqrt(0.5 * 10 ** (-draw.snr_db / 10)))
    unknown = np.full((BLOCK_UES, 3), np.nan, np.float32)
    pieces: list[Columns] = []
    for start in range(0, draw.ues, BLOCK_UES):  # a block's noise at a time, as there may be much
        frames = np.repeat(csi[start : start + BLOCK_UES], draw.frames, axis=0)
        noise = rng.standard_normal((*frames.shape, 2), np.float32).view(np.complex64)[..., 0]
        slots = np.repeat(np.arange(start, min(start + BLOCK_UES, draw.ues)), draw.frames)
        group = Grouping(slots)
        features = locator.features(frames + amplitude * noise)
        pieces.append(locator.estimate(group, features, unknown[: len(group)]))
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def _keywords(method: str) -> Keywords:
    values: Any = {"averaging": "mean", "theta": method, "rho": method}
    keywords: Keywords = values
    return keywords
