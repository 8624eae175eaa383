"""From a recording of several arrays to their poses and clocks: what is read of it, and what is told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from chachart.node.commands.shared.cli import progress
from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.estimation.fusion.estimator import clock_of
from chachart.node.estimation.fusion.events import Events, Gathering
from chachart.node.estimation.fusion.fuser import Clock
from chachart.node.estimation.fusion.heard import Heard
from chachart.node.estimation.fusion.options import FusionOptions
from chachart.node.estimation.fusion.placing import Placed, place
from chachart.node.estimation.fusion.receiver import usable
from chachart.node.estimation.fusion.strongest import Pathfinder, Paths
from chachart.node.files.recording import RecordingReader
from chachart.node.files.survey import Survey

MOST_TRANSMISSIONS = 4000
"""More add little; of a longer recording every so-many-th counts."""


def placed(
    reader: RecordingReader,
    survey: Survey | None,
    ues: list[int],
    clock: Clock | None,
    clocks_only: bool,
) -> tuple[list[Placed], Clock]:
    """Poses and offsets of all arrays of a recording, and by which clocks they are.

    Parameters
    ----------
    reader
        The recording.
    survey
        Where the UEs were; None: as the recording has it.
    ues
        Only these count; empty: all whose places are known.
    clock
        As of `place`; None: what the arrays' descriptions and the recording say.
    clocks_only
        Poses are as described.

    Raises
    ------
    SetupError
        If the recording does not hold what is needed.
    """
    if len(reader.arrays) < 2:
        raise SetupError(f"{reader.path}: --arrays is for recordings of several arrays, this is of one")
    clock = clock or clock_of(reader.arrays, reader.facts.delay)
    if clocks_only and clock == "own":
        raise SetupError("--clocks-only: the arrays have no clock in common (--clock says otherwise)")
    try:
        found = place(_heard(reader, survey, ues), clock, clocks_only)
    except ValueError as error:
        raise SetupError(f"{reader.path}: {error}") from None
    return found, clock


def _heard(reader: RecordingReader, survey: Survey | None, ues: list[int]) -> list[Heard]:
    finders = [Pathfinder(array) for array in reader.arrays]
    paths: list[list[Paths]] = [[] for _ in finders]
    position: list[list[Any]] = [[] for _ in finders]
    event: list[list[Any]] = [[] for _ in finders]
    count = 0
    for events in _transmissions(reader, survey, ues):
        for b, (array, frames) in enumerate(zip(reader.arrays, events.frames, strict=True)):
            heard = np.flatnonzero(frames.reshape(len(events), -1).any(axis=1))
            if len(heard):
                where = events.position[heard].astype(np.float64)
                far = np.linalg.norm(where - array.centre_m, axis=1)
                paths[b].append(finders[b](frames[heard], far))
                position[b].append(where)
                event[b].append(count + heard)
        count += len(events)
    found = []
    for b, array in enumerate(reader.arrays):
        if not paths[b]:
            raise ValueError(f"array {array.name} has heard no UE whose place is known")
        site = finders[b].site
        every = Paths.concatenate(paths[b]), np.concatenate(position[b]), np.concatenate(event[b])
        found.append(Heard(array, *every, site.cell_m, site.unambiguous_m))
    return found


def _transmissions(reader: RecordingReader, survey: Survey | None, ues: list[int]) -> Iterator[Events]:
    """Those whose place is known, thinned out."""
    number = {array.name: b for b, array in enumerate(reader.arrays)}
    shapes = [(array.antennas, array.subcarriers) for array in reader.arrays]
    gathering = Gathering(shapes, FusionOptions().window_ms)
    total = reader.summary().frames
    every = max(1, -(-total // (len(shapes) * MOST_TRANSMISSIONS)))
    seen = 0
    with progress("listening", total) as advance:
        for block in reader.blocks():
            advance(len(block))
            known = _known(block, survey, ues)
            if known is not None:
                gathering.add(number[known.array], known)
            if gathering.held > 1024 or known is None:
                seen = yield from _thinned(gathering.ready(), seen, every)
        yield from _thinned(gathering.ready(everything=True), seen, every)


def _thinned(events: Events | None, seen: int, every: int) -> Any:
    if events is None:
        return seen
    kept = (seen + np.arange(len(events))) % every == 0
    if kept.any():
        yield events.take(kept)
    return seen + len(events)


def _known(block: CsiBlock, survey: Survey | None, ues: list[int]) -> CsiBlock | None:
    """The good frames of UEs whose places are known."""
    good = usable(block, Counters())
    if good is None:
        return None
    if survey is not None:
        good = replace(good, position=survey.at(good.ue, good.time_ns).astype(np.float32))
    if good.position is None:
        return None
    counts = np.asarray(np.isfinite(good.position).all(axis=1))
    if ues:
        counts &= np.isin(good.ue, np.array(ues, np.uint64))
    return good.take(counts) if counts.any() else None


def lines(found: list[Placed], clock: Clock) -> Iterator[str]:
    """The report."""
    yield "array        frames  places   fit      moved     turned   offset of clock"
    for one in found:
        told = one.placement
        if told.position_m is None:
            moved, turned = "     -", "     -"
        else:
            moved = f"{one.moved_m:.3f} ± {np.linalg.norm(told.position_std_m):.3f} m"
            off = np.degrees(np.linalg.norm(told.turn_std_rad))
            turned = f"{np.degrees(one.turned_rad):.2f} ± {off:.2f} deg"
        offset = "-"
        if told.offset_s is not None:
            offset = f"{1e9 * told.offset_s:.2f} ± {1e9 * told.offset_std_s:.2f} ns"
        yield (
            f"{told.name:<12} {one.frames:6d} {one.places:7d} {100 * one.fits:4.0f} %  {moved:>18} "
            f"{turned:>18}   {offset}"
        )
    yield {
        "shared": "offsets are those of each array's clock against the UEs'",
        "offset": f"offsets are against the clock of array {found[0].placement.name}",
        "own": "the arrays have no clock in common: directions alone count",
    }[clock]


def as_json(found: list[Placed], clock: Clock) -> dict[str, Any]:
    """The report as plain values."""
    return {
        "clock": clock,
        "arrays": [
            {
                "name": one.placement.name,
                "frames": one.frames,
                "places": one.places,
                "fits": one.fits,
                "moved_m": one.moved_m,
                "turned_deg": float(np.degrees(one.turned_rad)),
                "offset_ns": None if one.placement.offset_s is None else 1e9 * one.placement.offset_s,
                "offset_std_ns": 1e9 * one.placement.offset_std_s,
                "position_m": one.placement.position_m,
                "axis": one.placement.axis,
                "broadside": one.placement.broadside,
                "position_std_m": one.placement.position_std_m,
                "turn_std_deg": np.degrees(one.placement.turn_std_rad).tolist(),
            }
            for one in found
        ],
    }
