"""What the captures of Wi-Fi cards share.

The csiread package decodes most of them; it trusts every length in a file, so each format here walks the
file first and tells what is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import Capture, Variable


class WifiCapture(Capture):
    """A capture that was decoded whole when it was opened."""

    def __init__(
        self,
        path: Path,
        name: str,
        arrays: Mapping[str, NDArray[Any]],
        axes: tuple[str, ...] = ("ue", "subcarrier", "antenna"),
    ) -> None:
        super().__init__(path, {key: Variable(a.shape, str(a.dtype)) for key, a in arrays.items()})
        self.format, self.axes = name, axes
        self._arrays = arrays

    def _read(self, name: str) -> NDArray[Any]:
        return self._arrays[name]


def csiread() -> Any:
    """The csiread package.

    Raises
    ------
    SetupError
        If it is not installed.
    """
    try:
        import csiread
    except ImportError:
        raise SetupError("Wi-Fi captures need the csiread package: pip install 'chachart[formats]'") from None
    return csiread


def streams(csi: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """CSI (frames, subcarriers, antennas, streams) as one variable a transmit stream: csi, csi_1, ..."""
    return {f"csi_{n}" if n else "csi": csi[..., n] for n in range(csi.shape[3])}


def alike(values: Sequence[tuple[int, ...]], what: str) -> tuple[int, ...]:
    """The one value that all frames share.

    Raises
    ------
    ValueError
        If there are no frames, or one of them differs from the first.
    """
    if not values:
        raise ValueError("it has no CSI frames")
    for n, value in enumerate(values):
        if value != values[0]:
            raise ValueError(f"frame {n} has {what} {value}, the first has {values[0]}")
    return values[0]


def unwrapped_ns(clock: NDArray[Any], bits: int, tick_ns: int) -> NDArray[np.int64]:
    """A counter of `bits` bits that wraps around, as nanoseconds that do not."""
    counts: NDArray[np.int64] = clock.astype(np.int64)
    steps = np.zeros_like(counts)
    steps[1:] = (counts[1:] - counts[:-1]) % np.int64(1 << bits)
    times: NDArray[np.int64] = (counts[0] + np.cumsum(steps)) * tick_ns
    return times
