"""Transmitters in wide-band samples: the channels of the band in which something is on the air.

Covariances go on as frames: a factor X (M, S) of the covariance R = X Xᴴ / S of a channel's samples, so that
whoever averages X Xᴴ over "subcarriers" gets R. S stands for how many independent samples R is worth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft


@dataclass(frozen=True, slots=True, eq=False)
class Burst:
    """Something on the air in one channel.

    Attributes
    ----------
    frequency_hz
        Middle of the channel.
    power_db
        Over the band's floor.
    covariance
        complex128 (M, M) of the channel's samples.
    samples
        How many independent ones it is made of.
    """

    frequency_hz: int
    power_db: float
    covariance: NDArray[np.complex128]
    samples: int


def channelise(samples: NDArray[np.complex64], rate_hz: float, width_hz: float) -> NDArray[np.complex64]:
    """Samples (M, N) by channel: (C, M, T), channel c being `width_hz` wide around (c - C // 2) width_hz.

    Raises
    ------
    ValueError
        If there are fewer samples than channels.
    """
    channels = max(round(rate_hz / width_hz), 1)
    m, n = samples.shape
    times = n // channels
    if times < 1:
        raise ValueError(f"{n} samples do not hold a channel of {width_hz:g} Hz")
    cut = samples[:, : times * channels].reshape(m, times, channels)
    window = np.sin(np.pi * (np.arange(channels) + 0.5) / channels).astype(np.float32)
    spectrum = fft.fftshift(fft.fft(cut * window, axis=2), axes=2)
    by_channel: NDArray[np.complex64] = spectrum.transpose(2, 0, 1)
    return by_channel


def bursts(
    samples: NDArray[np.complex64], centre_hz: float, rate_hz: float, width_hz: float, squelch_db: float
) -> list[Burst]:
    """The channels whose power is over the band's median by `squelch_db`, and over that of their neighbours.

    The middle of the band, where receivers leave a line of their own, does not count.
    """
    by_channel = channelise(samples, rate_hz, width_hz)
    count, m, times = by_channel.shape
    power = np.einsum("cmt,cmt->c", by_channel, by_channel.conj()).real / (m * times)
    # The median of one channel alone would be itself: a lone channel is always on the air.
    floor = float(np.median(power)) if count > 2 else 0.0
    over = power > floor * 10 ** (squelch_db / 10)
    if count > 2:
        left, right = np.roll(power, 1), np.roll(power, -1)
        over &= (power >= left) & (power > right)
        over[count // 2] = False
    found = []
    for c in np.flatnonzero(over & (power > 0)).tolist():
        x = by_channel[c].astype(np.complex128)
        frequency = round(centre_hz + (c - count // 2) * width_hz)
        level = 10 * np.log10(power[c] / floor) if floor else np.inf
        found.append(Burst(frequency, float(level), x @ x.conj().T / times, times))
    return found


def factor(covariance: NDArray[np.complex128], snapshots: int) -> NDArray[np.complex64]:
    """X (M, snapshots) with X Xᴴ / snapshots = covariance (M, M).

    Raises
    ------
    ValueError
        If `snapshots` is less than M.
    """
    m = len(covariance)
    if snapshots < m:
        raise ValueError(f"a covariance of {m} antennas needs at least as many subcarriers, not {snapshots}")
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    spread = np.exp(2j * np.pi * np.outer(np.arange(m), np.arange(snapshots)) / snapshots)
    x: NDArray[np.complex64] = (root @ spread).astype(np.complex64)
    return x
