"""The frames that every pair of estimators gets: the scenario's channels, or recorded ones, with noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from chachart.config.settings import ArraySettings
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingReader
from chachart.sources.scenario.channel import channels, mean_power
from chachart.sources.scenario.layout import place

ChannelName = Literal["los", "qlos", "qnlos"]

ANTENNAS = SUBCARRIERS = 32
LIGHT_SPEED_M_S = 3e8
"""As the published scenario rounds it."""
KNOWN_UES = 256
"""So many UEs come with their position, in the first block: the training set of LR."""
BLOCK_UES = 64
"""UEs of each further block: their frames and covariances stay in the processor's cache."""
MOST_BYTES = 4_000_000_000
"""Of noisy frames, which are kept in memory."""
_NOISE_STREAM, _TRAINING_STREAM = 2, 3


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Noisy frames of UEs that stand still.

    Attributes
    ----------
    channel, origin
        Which channel, and where it is from, in words.
    array
        What measured them.
    csi
        complex64 (U, frames, N_R, N_S).
    position
        (U, 3) true world positions.
    seed
        Of everything that is drawn.
    """

    channel: str
    origin: str
    array: ArrayGeometry
    csi: NDArray[np.complex64]
    position: NDArray[np.float64]
    seed: int

    @property
    def truth(self) -> NDArray[np.float64]:
        """True chart coordinates (U, 2) in metres."""
        return np.stack(self.array.chart_of(self.position), axis=1)

    def blocks(self, *, random_training: bool = False, positions: bool = True) -> Iterator[CsiBlock]:
        """All frames, those of a UE together, so that each UE is estimated once.

        Only the first block's positions are known: those of the first UEs, or of UEs drawn at random; without
        `positions`, none.
        """
        order = np.arange(len(self.csi))
        if random_training:
            order = np.random.default_rng([self.seed, _TRAINING_STREAM]).permutation(order)
        frames = self.csi.shape[1]
        ends = [*range(KNOWN_UES, len(order), BLOCK_UES), len(order)]
        for start, end in zip([0, *ends], ends, strict=False):
            ues = order[start:end]
            csi = self.csi[ues] if random_training else self.csi[start:end]
            known = positions and start == 0
            position = self.position[ues] if known else np.full((len(ues), 3), np.nan)
            yield CsiBlock(
                self.array.name,
                start * frames,
                np.repeat(ues.astype(np.uint64), frames),
                np.tile(np.arange(frames, dtype=np.int64), len(ues)),
                csi.reshape(-1, *csi.shape[2:]),
                np.repeat(position.astype(np.float32), frames, axis=0),
            )


def scenario_array(bandwidth_hz: float) -> ArrayGeometry:
    """The published scenario's array, its subcarriers over `bandwidth_hz` in all."""
    return ArraySettings(
        name="vip",
        antennas=ANTENNAS,
        subcarriers=SUBCARRIERS,
        subcarrier_spacing_hz=bandwidth_hz / SUBCARRIERS,
        light_speed_m_s=LIGHT_SPEED_M_S,
    ).geometry()


def modelled(
    channel: ChannelName, array: ArrayGeometry, ues: int, frames: int, snr_db: float, seed: int
) -> Scene:
    """The channel model's draw for the `vip` layout."""
    position = place("vip", ues, array, seed)
    csi = noisy(channels(channel, position, array, seed), frames, snr_db, seed)
    return Scene(channel, f"channel model, seed {seed}", array, csi, position, seed)


def recorded(channel: str, path: Path, ues: int, frames: int, snr_db: float, seed: int) -> Scene:
    """The channels of a recording that holds one noise-free frame of each UE, scaled to mean |h|^2 = 1.

    Raises
    ------
    SetupError
        If the recording cannot be read, has not just one frame of each UE, or lacks positions.
    """
    reader = RecordingReader(path)
    if (held := reader.summary().frames) > ues:
        raise SetupError(f"{path} holds {held} frames: at most {ues}, one of each UE, are used (see --ues)")
    blocks = list(reader.blocks())
    if not blocks:
        raise SetupError(f"{path} holds no frame")
    block = CsiBlock.concatenate(blocks)
    if len(np.unique(block.ue)) < len(block):
        raise SetupError(
            f"{path} holds {len(block)} frames of {len(np.unique(block.ue))} UEs: it must hold one frame "
            "without noise of each, for noise is added here"
        )
    if block.position is None or not np.isfinite(block.position).all():
        raise SetupError(f"{path}: the position of every UE must be known (chachart import --position)")
    block = block.take(np.argsort(block.ue))
    assert block.position is not None
    csi = block.csi / np.float32(np.sqrt(mean_power(block.csi)))
    position = block.position.astype(np.float64)
    return Scene(channel, path.name, reader.array, noisy(csi, frames, snr_db, seed), position, seed)


def noisy(csi: NDArray[np.complex64], frames: int, snr_db: float, seed: int) -> NDArray[np.complex64]:
    """`frames` times the channels (U, N_R, N_S), each with white noise of its own: (U, frames, N_R, N_S).

    The SNR is that of a channel of mean |h|^2 = 1.

    Raises
    ------
    SetupError
        If that takes more than `MOST_BYTES`.
    """
    rng = np.random.default_rng([seed, _NOISE_STREAM])
    u, *shape = csi.shape
    if (needed := csi.nbytes * frames) > MOST_BYTES:
        raise SetupError(
            f"{frames} frames of {u} UEs take {needed / 1e9:.0f} GB, more than {MOST_BYTES / 1e9:.0f}: "
            "fewer frames or UEs would do"
        )
    reals: NDArray[Any] = rng.standard_normal((u, frames, *shape, 2), np.float32)
    reals *= np.float32(np.sqrt(0.5 * 10 ** (-snr_db / 10)))
    out: NDArray[np.complex64] = reals.view(np.complex64)[..., 0]
    out += csi[:, None]
    return out
