"""Captures of several arrays: one recording of them all, in step."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from chachart.node.commands.shared.cli import progress, written_whole
from chachart.node.data.csi import CsiBlock
from chachart.node.data.facts import CaptureFacts, Delay
from chachart.node.files.recording import RecordingWriter
from chachart.sources.formats.base import Capture
from chachart.sources.formats.raytraced import SeveralArrays, read_raytraced

EPOCH_NS = 1_700_000_000 * 10**9
IN_STEP_S = 0.05
"""Blocks of the arrays take turns at least so often."""
MOST_FRAMES = 64


def run(capture: Capture, arguments: argparse.Namespace) -> int:
    """Import the capture.

    Raises
    ------
    SetupError
        If it does not go together, or the recording cannot be written.
    """
    whole = read_raytraced(capture, arguments.rate / arguments.repeat)
    rng = np.random.default_rng(arguments.seed)
    delay: Delay = arguments.delay or "absolute"
    options = {"repeat": arguments.repeat, "snr_db": arguments.snr_db, "seed": arguments.seed}
    note = {"file": capture.path.name, "format": capture.format, "options": options, "area_m": whole.area_m}
    total = len(whole.ue) * len(whole.arrays) * arguments.repeat
    facts = CaptureFacts(arguments.phase or "steady", delay)
    with (
        written_whole(arguments.recording) as file,
        RecordingWriter(
            file, whole.arrays[0], note=note, facts=facts, others=whole.arrays[1:], zstd=arguments.zstd
        ) as writer,
        progress("importing", total) as advance,
    ):
        for block in _blocks(whole, arguments, rng):
            writer.write(block)
            advance(len(block))
    first = whole.arrays[0]
    print(
        f"{arguments.recording}: {total} frames of {len(np.unique(whole.ue))} UEs, "
        f"{len(whole.arrays)} arrays of {first.antennas} antennas x {first.subcarriers} subcarriers, "
        f"from {capture.format}"
    )
    return 0


def _blocks(
    whole: SeveralArrays, arguments: argparse.Namespace, rng: np.random.Generator
) -> Iterator[CsiBlock]:
    """The frames in the order of time, the arrays in turn."""
    seq = [0] * len(whole.arrays)
    span_s = float(whole.time_s[-1] - whole.time_s[0]) + 1.0
    for again in range(arguments.repeat):
        csi = whole.csi if arguments.snr_db is None else whole.noisy(arguments.snr_db, rng)
        time_ns = EPOCH_NS + np.round((whole.time_s + again * span_s) * 1e9).astype(np.int64)
        step = np.floor((whole.time_s - whole.time_s[0]) / IN_STEP_S)
        cuts = np.concatenate([[0], np.flatnonzero(np.diff(step)) + 1, [len(step)]])
        for start, stop in _short(cuts):
            rows = slice(start, stop)
            for number, array in enumerate(whole.arrays):
                yield CsiBlock(
                    array.name,
                    seq[number],
                    whole.ue[rows],
                    time_ns[rows],
                    np.ascontiguousarray(csi[rows, number]),
                    whole.position[rows].astype(np.float32),
                )
                seq[number] += stop - start


def _short(cuts: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Iterator[tuple[int, int]]:
    for start, stop in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
        for part in range(start, stop, MOST_FRAMES):
            yield part, min(part + MOST_FRAMES, stop)
