"""Calibration start by start: which chains of a card have turned by 180 degrees, and a copy without it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.shared.cli import progress, written_whole
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.estimation import chain_flips
from chachart.node.files.recording import RecordingReader, RecordingWriter

UNSURE_RAD = float(np.radians(45.0))
MOST_FRAMES = 4096
"""So many frames of a start decide; more add nothing."""


@dataclass(frozen=True, slots=True)
class Start:
    """One start of the card: where its frames begin, which chains are turned (-1), how it is known.

    `off_rad` is by how much the worst chain is neither as before nor turned; `blind` says that no place of
    the transmitter is known: every other chain may then be turned, too.
    """

    first: int
    signs: tuple[int, ...]
    off_rad: float
    blind: bool

    @property
    def sure(self) -> bool:
        """Whether every chain is clearly one or the other."""
        return bool(self.off_rad < UNSURE_RAD)


def starts_of(reader: RecordingReader) -> list[int]:
    """Numbers of the frames with which starts begin: files of an import, and where the clock steps back."""
    found = {0, *(int(n) for n in reader.note.get("starts", []))}
    before, number = None, 0
    for block in reader.blocks():
        times = block.time_ns if before is None else np.concatenate([[before], block.time_ns])
        back = np.flatnonzero(np.diff(times) < 0) + (number + (1 if before is None else 0))
        found.update(back.tolist())
        before, number = block.time_ns[-1], number + len(block)
    return sorted(n for n in found if n < number)


def calibrated_starts(
    reader: RecordingReader, ues: list[int], position: tuple[float, float, float] | None
) -> list[Start]:
    """Each start of a recording beside the first: by UEs at known places, or by all UEs, blind.

    Raises
    ------
    SetupError
        If there is one antenna or one start only, or places are needed and not known.
    """
    array = reader.array
    if array.antennas < 2:
        raise SetupError(f"{reader.path}: one antenna has no phases to compare")
    begins = starts_of(reader)
    if len(begins) < 2:
        raise SetupError(
            f"{reader.path} has one start only: nothing to compare it with (import several files)"
        )
    elements = array.element_positions()
    found: list[Start] = []
    reference: dict[bool, NDArray[np.complex128]] = {}
    for first, frames, places in _by_start(reader, begins, ues, position):
        known = np.isfinite(places).all(axis=1)
        blind = not known.any()
        if blind and (ues or array.antennas < 3):
            what = (
                f"UE {ues[0]} has no known place in it" if ues else "two antennas need a UE at a known place"
            )
            raise SetupError(f"{reader.path}, start at frame {first}: {what} (--ue, --position X,Y,Z)")
        if blind:
            phasors = chain_flips.second_differences(frames)
        else:
            waves = chain_flips.expected_waves(elements, places[known], array.wavelength_m)
            phasors = chain_flips.deviations(frames[known], waves)
        beside = reference.setdefault(blind, phasors)
        compare = chain_flips.blind_signs_of if blind else chain_flips.signs_of
        signs, off = compare(beside, phasors)
        found.append(Start(first, tuple(signs.tolist()), off, blind))
    return found


def write_without_flips(reader: RecordingReader, starts: list[Start], target: Path) -> None:
    """A copy of a recording in which the chains are as at its first start; its note names what was turned.

    Starts of which it is not sure stay as they are.

    Raises
    ------
    SetupError
        If the file cannot be written.
    """
    applied = [start.signs if start.sure else (1,) * len(start.signs) for start in starts]
    turned = [
        {"first_frame": start.first, "signs": list(signs), "blind": start.blind, "sure": start.sure}
        for start, signs in zip(starts, applied, strict=True)
    ]
    note = {**reader.note, "chains_turned": turned}
    begins = np.array([start.first for start in starts])
    factors = np.array(applied, np.float32)
    number = 0
    with (
        written_whole(target) as file,
        RecordingWriter(file, reader.array, note=note, facts=reader.facts) as writer,
    ):
        for block in reader.blocks():
            which = np.searchsorted(begins, number + np.arange(len(block)), side="right") - 1
            csi = block.csi * factors[which][:, :, None]
            writer.write(CsiBlock(block.array, block.seq, block.ue, block.time_ns, csi, block.position))
            number += len(block)


def lines(starts: list[Start]) -> Iterator[str]:
    """The report."""
    for number, start in enumerate(starts):
        turned = [str(n) for n, sign in enumerate(start.signs) if sign < 0]
        told = f"chains {', '.join(turned)} turned by 180 degrees" if turned else "as the first"
        off = f"{np.degrees(start.off_rad):.0f} degrees off either"
        doubt = "" if start.sure else f"; not sure ({off}): left as it is"
        how = " (blind: up to every other chain)" if start.blind else ""
        yield f"start {number} at frame {start.first}: {told}{how}{doubt}"


def as_json(starts: list[Start]) -> dict[str, Any]:
    """The report as plain values."""
    return {
        "starts": [
            {
                "first_frame": start.first,
                "signs": list(start.signs),
                "off_deg": round(float(np.degrees(start.off_rad)), 3),
                "sure": start.sure,
                "blind": start.blind,
            }
            for start in starts
        ]
    }


def _by_start(
    reader: RecordingReader,
    begins: list[int],
    ues: list[int],
    position: tuple[float, float, float] | None,
) -> Iterator[tuple[int, NDArray[np.complex64], NDArray[np.float64]]]:
    """Of each start its first frame's number, frames (K, N_R, N_S) of the UEs, and their places (K, 3)."""
    wanted = np.array(ues, np.uint64)
    held: list[list[CsiBlock]] = [[] for _ in begins]
    counts = [0] * len(begins)
    number = 0
    with progress("reading", reader.summary().frames) as advance:
        for block in reader.blocks():
            which = np.searchsorted(begins, number + np.arange(len(block)), side="right") - 1
            mine = np.isin(block.ue, wanted) if ues else np.ones(len(block), bool)
            for start in np.unique(which).tolist():
                rows = np.flatnonzero(mine & (which == start))[: MOST_FRAMES - counts[start]]
                if len(rows):
                    held[start].append(block.take(rows))
                    counts[start] += len(rows)
            number += len(block)
            advance(len(block))
    for first, blocks in zip(begins, held, strict=True):
        if not blocks:
            raise SetupError(f"{reader.path}: no frame of UE {ues[0]} in the start at frame {first}")
        whole = CsiBlock.concatenate(blocks)
        places = np.full((len(whole), 3), np.nan)
        if position is not None:
            places[:] = position
        elif whole.position is not None and ues:
            places = whole.position.astype(np.float64)
        yield first, whole.csi, places
