"""The one interface of all channels, and channels by name."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.scenario.large_scale import QLOS, QNLOS
from chachart.sources.scenario.los import LosChannel
from chachart.sources.scenario.multipath import MultipathChannel

ChannelName = Literal["los", "qlos", "qnlos"]
Progress = Callable[[int, int], None]
"""Called with (UEs done, UEs in all)."""

_CHUNK_SAMPLES = 1 << 16
_CHUNK_UES = 256
_QUIET_S = 1.0


class Channel(Protocol):
    """The noise-free channel of every UE at every place: a pure function of the two."""

    array: ArrayGeometry

    def csi(self, ue: NDArray[Any], position: NDArray[Any]) -> NDArray[np.complex64]:
        """Channels complex64 (K, N_R, N_S) of the UEs `ue` (indices, K) at world positions (K, 3)."""


def make_channel(
    name: ChannelName, array: ArrayGeometry, start: NDArray[Any], seed: int = 0, exponent: float = 1.0
) -> Channel:
    """A channel by name, not yet normalised.

    Parameters
    ----------
    name
        `los`, see `LosChannel`; `qlos` and `qnlos`, see `MultipathChannel`.
    array
        The array that receives.
    start
        (U, 3) world positions of all UEs at time 0.
    seed
        Same seed, same channels.
    exponent
        Of the amplitude over distance, for `los`.
    """
    if name == "los":
        return LosChannel(array, exponent)
    return MultipathChannel({"qlos": QLOS, "qnlos": QNLOS}[name], array, start, seed)


def synthesise(
    channel: Channel, ue: NDArray[Any], position: NDArray[Any], out: NDArray[np.complex64]
) -> Iterator[int]:
    """Fill `out` (K, N_R, N_S) with the channels of the UEs `ue` (K,) at `position` (K, 3), piece by piece.

    Yields how many are done, after each piece; pieces are small enough for the processor's cache.
    """
    samples = channel.array.antennas * channel.array.subcarriers
    step = min(max(1, _CHUNK_SAMPLES // samples), _CHUNK_UES)
    for begin in range(0, len(ue), step):
        piece = slice(begin, begin + step)
        out[piece] = channel.csi(ue[piece], position[piece])
        yield min(begin + step, len(ue))


def mean_power(csi: NDArray[np.complex64]) -> float:
    """Mean of |h|^2 over everything; complex64 in, double precision sum."""
    flat = csi.reshape(len(csi), -1)
    return float(np.mean(np.einsum("un,un->u", flat, flat.conj()).real, dtype=np.float64)) / flat.shape[1]


def channels(
    name: ChannelName,
    positions: NDArray[Any],
    array: ArrayGeometry,
    seed: int = 0,
    progress: Progress | None = None,
    exponent: float = 1.0,
) -> NDArray[np.complex64]:
    """Noise-free channels complex64 (U, N_R, N_S) of UEs at `positions` (U, 3), mean |h|^2 = 1 over all.

    `progress(done, total)` is called from one second on, so that what is quick stays quiet.

    >>> array = ArrayGeometry("lab", 4, 2, 2e9, 312.5e3, 0.075)
    >>> channels("los", np.array([[100.0, 0.0, 0.0], [200.0, 50.0, 0.0]]), array).shape
    (2, 4, 2)
    """
    channel = make_channel(name, array, positions, seed, exponent)
    out = np.empty((len(positions), array.antennas, array.subcarriers), np.complex64)
    loud_from = time.monotonic() + _QUIET_S
    for done in synthesise(channel, np.arange(len(positions)), positions, out):
        if progress is not None and time.monotonic() >= loud_from:
            progress(done, len(positions))
    out *= np.float32(mean_power(out) ** -0.5)
    return out
