"""The unit of data: a block of CSI frames of one array."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


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
    packet
        uint64 (K,), a number that frames of one transmission share at all arrays, as a sender's sequence
        number, 0 where there is none; None if none has one.

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
    packet: NDArray[np.uint64] | None = None

    def __post_init__(self) -> None:
        k = len(self.ue)
        expected: list[tuple[str, NDArray[Any] | None, type, tuple[int, ...]]] = [
            ("ue", self.ue, np.uint64, (k,)),
            ("time_ns", self.time_ns, np.int64, (k,)),
            ("csi", self.csi, np.complex64, (k, *self.csi.shape[1:])),
            ("position", self.position, np.float32, (k, 3)),
            ("packet", self.packet, np.uint64, (k,)),
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
        packet = None if self.packet is None else self.packet[index]
        ue, time_ns = self.ue[index], self.time_ns[index]
        return CsiBlock(self.array, self.seq, ue, time_ns, self.csi[index], position, packet)

    def cut(self, start: int, stop: int) -> CsiBlock:
        """Frames `start` to `stop` as views, numbered as they were."""
        if start == 0 and stop >= len(self):
            return self
        rows = slice(start, stop)
        position = None if self.position is None else self.position[rows]
        packet = None if self.packet is None else self.packet[rows]
        ue, time_ns = self.ue[rows], self.time_ns[rows]
        return CsiBlock(self.array, self.seq + start, ue, time_ns, self.csi[rows], position, packet)

    @classmethod
    def of(
        cls,
        csi: ArrayLike,
        ue: ArrayLike,
        time_ns: ArrayLike | None = None,
        position: ArrayLike | None = None,
        *,
        array: str = "",
        seq: int = 0,
    ) -> CsiBlock:
        """A block of plain arrays of any numeric type.

        Parameters
        ----------
        csi
            (K, N_R, N_S), or one frame (N_R, N_S).
        ue, time_ns
            (K,), or one for all frames; the time is now where it is not told.
        position
            (K, 3) or (3,).

        Raises
        ------
        ValueError
            If a shape differs from the above, or a UE or time is no whole number of 64 bits.
        """
        frames = np.asarray(csi)
        if frames.dtype.kind not in "fciu" or frames.ndim not in (2, 3):
            raise ValueError(
                f"csi must be (frames, antennas, subcarriers), not {frames.dtype} {frames.shape}"
            )
        frames = frames.astype(np.complex64, copy=False).reshape(-1, *frames.shape[-2:])
        known = None if position is None else _each("position", position, np.float32, (len(frames), 3))
        now = time.time_ns() if time_ns is None else time_ns
        ids = _each("ue", ue, np.uint64, frames.shape[:1])
        return cls(array, seq, ids, _each("time_ns", now, np.int64, frames.shape[:1]), frames, known)

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
        packet = None
        if any(b.packet is not None for b in blocks):
            packet = np.concatenate(
                [np.zeros(len(b), np.uint64) if b.packet is None else b.packet for b in blocks]
            )
        return CsiBlock(
            first.array,
            first.seq,
            np.concatenate([b.ue for b in blocks]),
            np.concatenate([b.time_ns for b in blocks]),
            np.concatenate([b.csi for b in blocks]),
            position,
            packet,
        )


def _each(name: str, value: ArrayLike, dtype: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """`value` as an array of that type and shape; that of one frame is every frame's."""
    given = np.asarray(value)
    if np.dtype(dtype).kind in "iu":
        if given.dtype.kind not in "iu":
            given = np.array(value, object)  # numpy takes a list of large and small numbers for floats
            if not all(isinstance(number, int | np.integer) for number in given.flat):
                raise ValueError(f"{name} must be whole numbers")
        limits = np.iinfo(np.dtype(dtype).name)
        if given.size and not (limits.min <= given.min() and given.max() <= limits.max):
            raise ValueError(f"{name} must be {limits.dtype}, not {given.min()} to {given.max()}")
    if given.shape not in (shape, shape[1:]):
        raise ValueError(f"{name} must be {shape}, not {given.shape}")
    return np.broadcast_to(given, shape).astype(dtype)
