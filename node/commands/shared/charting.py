"""Charts for commands: of recordings, estimated in this process, and out of chart logs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from chachart.config.load import NodeSettings, settings_of
from chachart.node.commands.shared.cli import progress
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import RhoMethod, ThetaMethod
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.options import Options
from chachart.node.files.calibration import load_calibration
from chachart.node.files.chart_log import ChartLogReader, is_chart_log
from chachart.node.files.recording import RecordingReader

BATCH_FRAMES = 1024
"""Frames that the estimator gets at once: one estimate for each UE among them."""
FEWEST_UES = 4
"""With fewer known positions, no figure means anything."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options that say how a recording is charted."""
    parser.add_argument("--theta", choices=get_args(ThetaMethod), help="angle method (bartlett)")
    parser.add_argument("--rho", choices=get_args(RhoMethod), help="distance method (as --theta)")
    parser.add_argument(
        "--set",
        action="extend",
        nargs="+",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="change a setting of [estimator] or [quality], as for chachart-node",
    )
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="instead of the recording's own")


def methods_for(array: ArrayGeometry, facts: CaptureFacts) -> tuple[ThetaMethod, RhoMethod, str]:
    """The methods that make sense for a capture where nobody chose any, and why in words (empty: the usual).

    Raises
    ------
    SetupError
        If nothing of it can be charted.
    """
    antennas, tones = np.count_nonzero(array.live_antennas), np.count_nonzero(array.live_tones)
    theta, rho = Options().theta, Options().rho
    why = []
    if antennas < 2:
        theta = "none"
        why.append("one antenna sees no direction")
    if facts.delay == "relative" or tones < 2:
        why.append("its delays are no distances" if tones > 1 else "one subcarrier sees no delay")
        rho = "isq" if facts.power != "raw" or facts.delay == "absolute" else "none"
        if rho == "none":
            why.append("its amplitudes are not those received")
    if theta == rho == "none":
        raise SetupError(f"nothing can be charted: {', '.join(why)}")
    return theta, rho, ", ".join(why)


def settings_for(arguments: argparse.Namespace, reader: RecordingReader) -> NodeSettings:
    """The settings that the options of `add_options` make; all frames of a UE count alike.

    Methods that are not chosen are those that the recording allows.

    Raises
    ------
    SetupError
        If one does not fit.
    """
    for change in arguments.set:
        section = change.partition(".")[0].strip()
        if section not in ("estimator", "quality", "fusion", "tracking"):
            raise SetupError(
                f"--set {change}: only [estimator], [quality], [fusion] and [tracking] count, "
                "the array is the recording's"
            )
    theta, rho = arguments.theta, arguments.rho
    if theta is None or rho is None:
        usual_theta, usual_rho, why = methods_for(reader.array, reader.facts)
        if not why:
            theta = theta or ("joint" if rho == "joint" else usual_theta)
            rho = rho or theta
        theta, rho = theta or usual_theta, rho or usual_rho
    document = {
        "source": {"type": "recording", "path": str(reader.path)},
        "estimator": {"theta": theta, "rho": rho, "averaging": "mean"},
    }
    return settings_of(document, arguments.set, "options")


def estimator_for(
    reader: RecordingReader, settings: NodeSettings, calibration: Path | None
) -> ChartEstimator:
    """An estimator for the recording's frames, with another calibration than its own if one is named.

    Raises
    ------
    SetupError
        If a setting or the calibration does not fit the array.
    """
    array = reader.array
    if calibration is not None:
        try:
            array = replace(array, calibration=load_calibration(calibration))
        except ValueError as error:
            raise SetupError(f"--calibration: {error}") from None
    try:
        return ChartEstimator(array, **settings.estimator.obeying(reader.facts).keywords())
    except ValueError as error:
        raise SetupError(f"[estimator] {error}") from None


def estimate(reader: RecordingReader, estimator: ChartEstimator) -> tuple[ChartUpdate, int]:
    """The last estimates of every UE, and how many frames there were.

    Raises
    ------
    SetupError
        If no frame could be used.
    """
    updates: list[ChartUpdate] = []
    frames = waiting = 0
    with progress("charting", reader.summary().frames) as advance:
        for batch in _batches(reader):
            update = estimator.update(batch)
            frames += len(batch)
            advance(len(batch))
            if len(update):
                updates.append(update)
                waiting += len(update)
            if waiting > 8 * max(estimator.ues, BATCH_FRAMES):
                updates, waiting = [ChartUpdate.concatenate(updates)], 0
    if not updates:
        rejected = ", ".join(f"{n} {reason}" for reason, n in estimator.rejected.as_dict().items())
        raise SetupError(f"{reader.path}: no frame could be used, of {frames} ({rejected or 'it is empty'})")
    return ChartUpdate.concatenate(updates), frames


def chart_recording(path: str | Path, **options: Any) -> ChartUpdate:
    """The chart of a recording: the newest row of every UE, all frames of a UE counting alike.

    Parameters
    ----------
    path
        The recording.
    options
        As of `ChartEstimator`, where averaging is "mean" unless said otherwise.

    Raises
    ------
    SetupError
        If the file is no recording, or no frame of it could be used.
    ValueError
        If an option does not fit the recording's array.
    """
    reader = RecordingReader(Path(path))
    theta, rho, why = methods_for(reader.array, reader.facts)
    usual: dict[str, Any] = {"averaging": "mean", **({"theta": theta, "rho": rho} if why else {})}
    keywords = Options.of(**{**usual, **options}).obeying(reader.facts).keywords()
    chart, _ = estimate(reader, ChartEstimator(reader.array, **keywords))
    return chart


@dataclass(frozen=True, slots=True)
class Charted:
    """A chart, its array, and what to call it."""

    chart: ChartUpdate
    array: ArrayGeometry
    name: str

    def known(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Truth and chart (N, 2) in metres, x along broadside and y along the axis, of the UEs with both.

        Raises
        ------
        SetupError
            If they are too few.
        """
        position = self.chart.position
        known = np.zeros(0, np.intp)
        if position is not None:
            known = np.flatnonzero(np.isfinite(position).all(axis=1))
        if position is None or len(known) < FEWEST_UES:
            raise SetupError(
                f"{self.name}: {len(known)} UEs have a known position; to compare, {FEWEST_UES} are needed"
            )
        truth = np.stack(self.chart.truth_of(self.array), axis=1)[known]
        return truth, np.stack([self.chart.x[known], self.chart.y[known]], axis=1)


def charted(arguments: argparse.Namespace) -> Charted:
    """The chart of one recording, or of one or several parts of a chart log.

    Raises
    ------
    SetupError
        If a file is neither, or has no chart.
    """
    paths: Sequence[Path] = arguments.files
    if is_chart_log(paths[0]):
        return logged(paths)
    if len(paths) > 1:
        raise SetupError(f"one recording at a time, not {len(paths)} files")
    reader = RecordingReader(paths[0])
    settings = settings_for(arguments, reader)
    chart, _ = estimate(reader, estimator_for(reader, settings, arguments.calibration))
    return Charted(chart, reader.array, _name(paths[0], chart))


def logged(paths: Sequence[Path]) -> Charted:
    """The newest row of every UE in the parts of a chart log.

    Raises
    ------
    SetupError
        If a file is no chart log, or of another array, or there is no row.
    """
    readers = [ChartLogReader(path) for path in paths]
    array = readers[0].array
    for reader in readers[1:]:
        if differences := array.mismatches(reader.array):
            raise SetupError(f"{reader.path} is of another array than {paths[0]}: {differences[0]}")
    charts = [chart for reader in readers if (chart := reader.chart()) is not None]
    for reader in readers:
        for reason, count in reader.damaged.as_dict().items():
            print(f"{reader.path}: left out {count} ({reason})", file=sys.stderr)
    if not charts:
        raise SetupError(f"{paths[0]} has no chart in it")
    chart = ChartUpdate.concatenate(charts)
    return Charted(chart, array, _name(paths[0], chart))


def _name(path: Path, chart: ChartUpdate) -> str:
    return f"{path.name}, {chart.method.theta}/{chart.method.rho}"


def _batches(reader: RecordingReader) -> Iterator[CsiBlock]:
    blocks: list[CsiBlock] = []
    for block in reader.blocks():
        blocks.append(block)
        if sum(map(len, blocks)) >= BATCH_FRAMES:
            yield CsiBlock.concatenate(blocks)
            blocks = []
    if blocks:
        yield CsiBlock.concatenate(blocks)
