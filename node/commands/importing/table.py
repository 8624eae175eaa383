"""The frames that go into a recording: of one file or several, in order, with noise where asked for."""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.sources.formats.arrange import defects, occurrence

BLOCK_FRAMES = 64
BETWEEN_FILES_NS = 1_000_000_000
"""Where clocks of several files have nothing to do with each other, so much time lies between them."""


@dataclass(frozen=True, slots=True)
class Band:
    """What a file says of its antennas and subcarriers; None: nothing.

    `tones` numbers the subcarriers, `weak` names those of them that do not count.
    """

    carrier_hz: float | None = None
    spacing_hz: float | None = None
    tones: tuple[int, ...] | None = None
    weak: tuple[int, ...] = ()
    antenna_names: tuple[str, ...] = ()


@dataclass(slots=True)
class Part:
    """The frames of one file.

    Attributes
    ----------
    source
        The file.
    csi, ue
        complex64 (K, N_R, N_S) and uint64 (K,).
    time_ns, position
        int64 (K,) and float32 (K, 3); None where not known.
    number
        int (K,), numbers of the frames in the file.
    keep_order
        Whether frames stay in the order of the file although their clock may step back.
    frames_in_file, left_out
        Frames of the file, and those of them that are not here, by reason.
    snr_db
        float (K,) where the file tells signal and noise; None elsewhere.
    remarks
        What else to tell.
    """

    source: Path
    csi: NDArray[np.complex64]
    ue: NDArray[np.uint64]
    time_ns: NDArray[np.int64] | None
    position: NDArray[np.float32] | None
    number: NDArray[np.int64]
    keep_order: bool = False
    frames_in_file: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    snr_db: NDArray[np.float64] | None = None
    remarks: list[str] = field(default_factory=list)

    def take(self, rows: NDArray[np.int64]) -> None:
        """Keep these frames, in this order."""
        self.csi, self.ue, self.number = self.csi[rows], self.ue[rows], self.number[rows]
        self.time_ns = None if self.time_ns is None else self.time_ns[rows]
        self.position = None if self.position is None else self.position[rows]
        self.snr_db = None if self.snr_db is None else self.snr_db[rows]


@dataclass(frozen=True, slots=True)
class CaptureTable:
    """All frames: csi (K, N_R, N_S), who, when (None: by rate) and where (None: unknown)."""

    csi: NDArray[np.complex64]
    ue: NDArray[np.uint64]
    time_ns: NDArray[np.int64] | None
    position: NDArray[np.float32] | None
    noise_std: float

    def blocks(self, array: str, repeat: int, rate_hz: float, seed: int) -> Iterator[CsiBlock]:
        """All frames once, then all again, `repeat` times, with fresh noise each time."""
        rng = np.random.default_rng(seed)
        total = len(self.ue) * repeat
        for start in range(0, total, BLOCK_FRAMES):
            n = np.arange(start, min(start + BLOCK_FRAMES, total))
            row = n % len(self.ue)
            csi = self.csi[row]
            if self.noise_std:
                noise = rng.standard_normal((*csi.shape, 2), np.float32) * np.float32(self.noise_std)
                csi = csi + noise.view(np.complex64)[..., 0]
            times = (n / rate_hz * 1e9).astype(np.int64) if self.time_ns is None else self.time_ns[row]
            position = None if self.position is None else self.position[row]
            yield CsiBlock(array, start, self.ue[row], times, csi, position)


def drop_bad(part: Part, name: str, strict: bool) -> None:
    """Leave out frames that are zero, constant or not finite, and count them.

    Raises
    ------
    SetupError
        If no frame is left, or one is bad although `strict`.
    """
    found = defects(part.csi)
    bad = found != ""
    if strict and bad.any():
        first, count = int(np.flatnonzero(bad)[0]), int(np.count_nonzero(bad))
        others = f", as are {count - 1} others" if count > 1 else ""
        frame = f'frame {part.number[first]} of "{name}" {found[first]}'
        raise SetupError(f"{part.source}: {frame}{others} (--strict)")
    if bad.all():
        reasons = ", ".join(f"{count} {reason}" for reason, count in Counter(found.tolist()).items())
        raise SetupError(
            f'{part.source}: every frame of "{name}" is zero, constant or not finite ({reasons})'
        )
    part.left_out += Counter(str(reason).removeprefix("is ") for reason in found[bad])
    part.take(np.flatnonzero(~bad))


def refuse_losses(parts: list[Part]) -> None:
    """What --strict asks for: an error that names the first file of which something is left out.

    Raises
    ------
    SetupError
        If anything is.
    """
    for part in parts:
        if part.left_out:
            told = ", ".join(f"{count} {reason}" for reason, count in part.left_out.items())
            raise SetupError(f"{part.source}: --strict: of {part.frames_in_file} frames are left out {told}")


def table_of(parts: list[Part], arguments: argparse.Namespace) -> CaptureTable:
    """All parts, one after another, in the order in which they are to be written."""
    _spread(parts)
    csi = parts[0].csi if len(parts) == 1 else np.concatenate([part.csi for part in parts])
    ue = np.concatenate([part.ue for part in parts])
    times = [part.time_ns for part in parts if part.time_ns is not None]
    time_ns = np.concatenate(times) if len(times) == len(parts) and arguments.repeat == 1 else None
    position = None
    if any(part.position is not None for part in parts):
        unknown = np.full((1, 3), np.nan, np.float32)
        position = np.concatenate(
            [np.repeat(unknown, len(p.ue), 0) if p.position is None else p.position for p in parts]
        )
    if not any(part.keep_order for part in parts):
        # By time where it is known, else every UE's first frame, every UE's second, ...
        order = np.argsort(occurrence(ue) if time_ns is None else time_ns, kind="stable")
        csi, ue = csi[order], ue[order]
        time_ns = None if time_ns is None else time_ns[order]
        position = None if position is None else position[order]
    noise_std = 0.0
    if arguments.snr_db is not None:
        power = float(np.mean(np.square(np.abs(csi), dtype=np.float64)))
        csi = csi / np.float32(math.sqrt(power))
        noise_std = math.sqrt(0.5 * 10 ** (-arguments.snr_db / 10))
    return CaptureTable(csi, ue, time_ns, position, noise_std)


def _spread(parts: list[Part]) -> None:
    """Move the times of files that do not come after those before them."""
    latest: int | None = None
    for part in parts:
        if part.time_ns is None or not part.keep_order:
            return
        first = int(part.time_ns.min())
        if latest is not None and first <= latest:
            shift = latest + BETWEEN_FILES_NS - first
            part.time_ns = part.time_ns + shift
            part.remarks.append(
                f"its times are moved by {shift / 1e9:+.3f} s, behind those of the file before"
            )
        latest = int(part.time_ns.max())
