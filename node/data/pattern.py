"""What the elements of an array see by themselves: gain and phase over directions, as a Fourier series.

The effective aperture distribution function (Landmann and Del Galdo 2004): the pattern, continued over the
poles, is periodic in azimuth and elevation; a few coefficients tell it everywhere, derivatives included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

NEGLIGIBLE = 1e-9
"""Share of a pattern's energy that may be cut off with its highest lags."""
MAX_NUMBERS = 1 << 18


@dataclass(frozen=True, slots=True)
class Pattern:
    """Patterns of N elements: g_n = sum_lk c_nlk exp(j (l elevation + k azimuth)), l and k from -L and -K on.

    Parameters
    ----------
    shape
        (N, 2 L + 1, 2 K + 1).
    real, imag
        The coefficients c, flat.

    Raises
    ------
    ValueError
        If the numbers do not fit the shape.
    """

    shape: tuple[int, int, int]
    real: tuple[float, ...]
    imag: tuple[float, ...]

    def __post_init__(self) -> None:
        n, rows, columns = self.shape
        size = n * rows * columns
        if min(self.shape) < 1 or rows % 2 == 0 or columns % 2 == 0 or size > MAX_NUMBERS:
            raise ValueError(f"pattern: shape must be elements and two odd numbers, not {self.shape}")
        for name in ("real", "imag"):
            values = np.asarray(getattr(self, name), np.float64)
            if values.shape != (size,) or not np.isfinite(values).all():
                raise ValueError(f"pattern: {name} must be {size} finite numbers")

    @classmethod
    def of_samples(cls, samples: NDArray[Any]) -> Self:
        """From complex gains (N, E, A) at elevations -90 to 90 degrees and azimuths -180 to 180, both evenly.

        The last azimuth is the first one again, and may be left out.
        """
        gains = np.asarray(samples, np.complex128)
        if gains.ndim != 3 or gains.shape[1] < 3 or gains.shape[2] < 4:
            raise ValueError(f"pattern: samples must be (elements, elevations, azimuths), not {gains.shape}")
        if gains.shape[2] % 2:
            gains = gains[:, :, :-1]
        azimuths = gains.shape[2]
        # beyond a pole, elevation goes on at the opposite azimuth
        beyond = np.roll(gains[:, -2:0:-1], azimuths // 2, axis=2)
        whole = np.concatenate([gains, beyond], axis=1)
        n, rows, _ = whole.shape
        c = np.fft.fftshift(np.fft.fft2(whole, norm="forward"), axes=(1, 2))
        lags = np.arange(rows) - rows // 2, np.arange(azimuths) - azimuths // 2
        # samples begin at elevation -90 and azimuth -180 degrees
        c = c * np.exp(1j * np.pi / 2 * lags[0])[:, None] * np.exp(1j * np.pi * lags[1])
        keep = [_span(np.abs(c) ** 2, axis, lag) for axis, lag in zip((1, 2), lags, strict=True)]
        c = c[:, np.abs(lags[0]) <= keep[0]][:, :, np.abs(lags[1]) <= keep[1]]
        return cls(
            (n, c.shape[1], c.shape[2]), tuple(c.real.ravel().tolist()), tuple(c.imag.ravel().tolist())
        )

    @property
    def elements(self) -> int:
        """N."""
        return self.shape[0]

    def gains(self, d: Floats) -> Complex:
        """Gains (K, N) in own directions d (K, 3)."""
        c = (np.array(self.real) + 1j * np.array(self.imag)).reshape(self.shape)
        elevation = np.arcsin(np.clip(d[:, 1], -1, 1))
        azimuth = np.arctan2(d[:, 0], d[:, 2])
        rows = np.exp(1j * elevation[:, None] * (np.arange(self.shape[1]) - self.shape[1] // 2))
        columns = np.exp(1j * azimuth[:, None] * (np.arange(self.shape[2]) - self.shape[2] // 2))
        gains: Complex = np.einsum("dl,nlk,dk->dn", rows, c, columns, optimize=True)
        return gains

    def as_dict(self) -> dict[str, Any]:
        """Plain values; `from_dict` reads them back."""
        return {name: list(values) for name, values in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Build from `as_dict`'s values.

        Raises
        ------
        ValueError
            If they are none.
        """
        try:
            rows = {name: tuple(values[name]) for name in ("shape", "real", "imag")}
            return cls(**rows)
        except (KeyError, TypeError, OverflowError) as error:
            raise ValueError(f"not a pattern: {error!r}") from None


def _span(power: Floats, axis: int, lags: NDArray[Any]) -> int:
    """The lag up to which all energy but a negligible share lies."""
    other = tuple(a for a in range(power.ndim) if a != axis)
    by_lag = power.sum(axis=other)
    order = np.abs(lags)
    total = by_lag.sum()
    for most in range(int(order.max())):
        if by_lag[order > most].sum() <= NEGLIGIBLE * total:
            return most
    return int(order.max()) - 1
