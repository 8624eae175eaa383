"""Chart updates: where some UEs are, as far as the node can tell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Method:
    """Names of the estimators behind a chart."""

    theta: str
    rho: str


@dataclass(frozen=True, slots=True, eq=False)
class ChartUpdate:
    """Estimates for K UEs of one array, one row a UE.

    Attributes
    ----------
    array, method
        Which array, and which estimators.
    ue, time_ns
        uint64 (K,) and int64 (K,): who, and the time of the last frame behind the estimate.
    theta, rho
        float64 (K,): cone angle to the array axis (rad, 0..pi) and slant range (m).
    theta_std, rho_std
        float64 (K,): standard deviations of theta (rad) and rho (m); NaN where the method gives none.
    x, y
        float64 (K,): chart coordinates in metres, see `chachart.node.data.geometry`.
    snr
        float64 (K,): signal to noise ratio in dB.
    snapshots
        float64 (K,): effective number of frames behind the estimate.
    position
        float32 (K, 3): known reference positions, world metres, NaN where unknown; None if none is known.
    """

    array: str
    method: Method
    ue: NDArray[np.uint64]
    time_ns: NDArray[np.int64]
    theta: Floats
    rho: Floats
    theta_std: Floats
    rho_std: Floats
    x: Floats
    y: Floats
    snr: Floats
    snapshots: Floats
    position: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        for f in fields(self)[2:-1]:
            if getattr(self, f.name).shape != self.ue.shape:
                raise ValueError(
                    f"{f.name} must have shape {self.ue.shape}, not {getattr(self, f.name).shape}"
                )
        if self.position is not None and self.position.shape != (len(self.ue), 3):
            raise ValueError(f"position must be {(len(self.ue), 3)}, not {self.position.shape}")

    def __len__(self) -> int:
        return len(self.ue)

    def take(self, index: NDArray[Any]) -> ChartUpdate:
        """The rows that `index` (integers or a mask) picks, in that order."""
        columns = {f.name: getattr(self, f.name)[index] for f in fields(self)[2:-1]}
        position = None if self.position is None else self.position[index]
        return ChartUpdate(self.array, self.method, position=position, **columns)

    def parts(self, rows: int) -> Iterator[ChartUpdate]:
        """The same in pieces of at most `rows` rows, none where there is no row."""
        if 0 < len(self) <= rows:
            yield self
            return
        for start in range(0, len(self), rows):
            yield self.take(np.arange(start, min(start + rows, len(self))))

    @staticmethod
    def concatenate(updates: list[ChartUpdate]) -> ChartUpdate:
        """All rows in order; a UE that occurs twice keeps its last row. Array and method are the last's."""
        last = updates[-1]
        if len(updates) == 1:
            return last
        columns = {f.name: np.concatenate([getattr(u, f.name) for u in updates]) for f in fields(last)[2:-1]}
        position = None
        if any(u.position is not None for u in updates):
            position = np.concatenate(
                [
                    np.full((len(u), 3), np.nan, np.float32) if u.position is None else u.position
                    for u in updates
                ]
            )
        everything = ChartUpdate(last.array, last.method, position=position, **columns)
        _, from_end = np.unique(everything.ue[::-1], return_index=True)
        return everything.take(np.sort(len(everything) - 1 - from_end))
