"""The unit of data: a block of CSI frames of one array."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class CsiBlock:
    """K >= 1 frames of one array.

    Attributes
    ----------
    array
        Which array measured them.
    seq
        Number of the block's first frame from this source.
    ue
        uint64 (K,), who transmitted.
    time_ns
        int64 (K,), nanoseconds since the Unix epoch.
    csi
        complex64 (K, N_R antennas, N_S subcarriers).
    position
        float32 (K, 3), known reference positions in metres, NaN where unknown; None if none is known.

    Raises
    ------
    ValueError
        If a shape or a dtype differs from the above.
    """

    array: str
    seq: int
    ue: NDArray[np.uint64]
    time_ns: NDArray[np.int64]
    csi: NDArray[np.complex64]
    position: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        k = len(self.ue)
        expected: list[tuple[str, NDArray[Any] | None, type, tuple[int, ...]]] = [
            ("ue", self.ue, np.uint64, (k,)),
            ("time_ns", self.time_ns, np.int64, (k,)),
            ("csi", self.csi, np.complex64, (k, *self.csi.shape[1:])),
            ("position", self.position, np.float32, (k, 3)),
        ]
        for name, value, dtype, shape in expected:
            if value is not None and (value.dtype != dtype or value.shape != shape):
                raise ValueError(
                    f"{name} must be {np.dtype(dtype).name} {shape}, not {value.dtype} {value.shape}"
                )
        if k == 0 or self.csi.ndim != 3:
            raise ValueError(f"csi must be (frames >= 1, antennas, subcarriers), not {self.csi.shape}")

    def __len__(self) -> int:
        return len(self.ue)

    def __repr__(self) -> str:
        _, antennas, subcarriers = self.csi.shape
        who = f"{len(self)} frames of {len(np.unique(self.ue))} UEs"
        known = "" if self.position is None else ", position"
        return f"<CsiBlock of {self.array!r} from {self.seq}: {who}, {antennas} x {subcarriers}{known}>"

    @property
    def antennas(self) -> int:
        """N_R."""
        return int(self.csi.shape[1])

    @property
    def subcarriers(self) -> int:
        """N_S."""
        return int(self.csi.shape[2])

    def take(self, index: NDArray[Any]) -> CsiBlock:
        """The frames that `index` (integers or a mask) picks, in that order."""
        position = None if self.position is None else self.position[index]
        return CsiBlock(self.array, self.seq, self.ue[index], self.time_ns[index], self.csi[index], position)

    def cut(self, start: int, stop: int) -> CsiBlock:
        """Frames `start` to `stop` as views, numbered as they were."""
        if start == 0 and stop >= len(self):
            return self
        rows = slice(start, stop)
        position = None if self.position is None else self.position[rows]
        return CsiBlock(
            self.array, self.seq + start, self.ue[rows], self.time_ns[rows], self.csi[rows], position
        )

    @staticmethod
    def concatenate(blocks: list[CsiBlock]) -> CsiBlock:
        """One block of all frames, in order; `array` and `seq` are the first block's."""
        if len(blocks) == 1:
            return blocks[0]
        first = blocks[0]
        position = None
        if any(b.position is not None for b in blocks):
            position = np.concatenate(
                [
                    np.full((len(b), 3), np.nan, np.float32) if b.position is None else b.position
                    for b in blocks
                ]
            )
        return CsiBlock(
            first.array,
            first.seq,
            np.concatenate([b.ue for b in blocks]),
            np.concatenate([b.time_ns for b in blocks]),
            np.concatenate([b.csi for b in blocks]),
            position,
        )
