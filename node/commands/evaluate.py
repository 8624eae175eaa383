"""Chart a recording in this process, as fast as it goes, and say how good the chart is.

    chachart evaluate capture.mcap --theta music --rho music --chart chart.png --json quality.json
    chachart evaluate capture.mcap --set estimator.averaging=exponential estimator.memory_frames=16

All frames of a UE count alike unless --set says otherwise.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from chachart.config.calibration import load_calibration
from chachart.config.load import NodeSettings, settings_of
from chachart.config.settings import EstimatorSettings, RhoMethod, ThetaMethod
from chachart.node.chart import ChartUpdate
from chachart.node.commands.cli import check_writable, progress
from chachart.node.csi import CsiBlock
from chachart.node.errors import SetupError
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.quality import assess
from chachart.node.geometry import ArrayGeometry
from chachart.node.recording import RecordingReader

BATCH_FRAMES = 1024
"""Frames that the estimator gets at once: one estimate for each UE among them."""
FEWEST_UES = 4
"""With fewer known positions, no figure means anything."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart evaluate`."""
    parser.add_argument("recording", type=Path, metavar="FILE.mcap", help="the recording")
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
    parser.add_argument("--chart", type=Path, metavar="FILE.png", help="draw truth and chart side by side")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate the recording.

    Raises
    ------
    SetupError
        If the recording or a setting does not fit.
    """
    for path in (arguments.chart, arguments.json):
        if path is not None:
            check_writable(path, force=True)
    settings = _settings(arguments)
    reader = RecordingReader(arguments.recording)
    array = _array(reader, arguments.calibration)
    try:
        estimator = ChartEstimator(array, **settings.estimator.model_dump())
    except ValueError as error:
        raise SetupError(f"[estimator] {error}") from None
    started = time.perf_counter()
    chart, frames = _chart(reader, estimator)
    seconds = time.perf_counter() - started
    figures: dict[str, Any] = {
        "tw": None,
        "ct": None,
        "k": None,
        "stress": None,
        "error_m": None,
        "seconds": seconds,
        "frames": frames,
        "ues": len(chart),
        "rejected": estimator.rejected.as_dict() | reader.damaged.as_dict(),
    }
    known = np.zeros(0) if chart.position is None else np.flatnonzero(np.isfinite(chart.position).all(axis=1))
    remark = f"only {len(known)} UEs have a known position: nothing to compare with"
    if len(known) >= FEWEST_UES:
        try:
            figures |= assess(
                chart.take(known), reader.array, settings.quality.k, settings.quality.exact_ues
            ) | {"ues": len(chart)}
        except ValueError as error:
            remark = str(error)
    method = f"{estimator.method.theta}/{estimator.method.rho}"
    _print(arguments.recording, method, figures, remark)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
    if arguments.chart is not None:
        from chachart.node.commands.figure import draw

        draw(arguments.chart, chart, reader.array, f"{arguments.recording.name}, {method}")
    return 0


def _array(reader: RecordingReader, calibration: Path | None) -> ArrayGeometry:
    if calibration is None:
        return reader.array
    try:
        return replace(reader.array, calibration=load_calibration(calibration))
    except ValueError as error:
        raise SetupError(f"--calibration: {error}") from None


def _settings(arguments: argparse.Namespace) -> NodeSettings:
    theta = arguments.theta or ("joint" if arguments.rho == "joint" else EstimatorSettings().theta)
    document = {
        "source": {"type": "recording", "path": str(arguments.recording)},
        "estimator": {"theta": theta, "rho": arguments.rho or theta, "averaging": "mean"},
    }
    return settings_of(document, arguments.set, "options")


def _chart(reader: RecordingReader, estimator: ChartEstimator) -> tuple[ChartUpdate, int]:
    """The last estimates of every UE, and how many frames there were."""
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


def _batches(reader: RecordingReader) -> Iterator[CsiBlock]:
    blocks: list[CsiBlock] = []
    for block in reader.blocks():
        blocks.append(block)
        if sum(map(len, blocks)) >= BATCH_FRAMES:
            yield CsiBlock.concatenate(blocks)
            blocks = []
    if blocks:
        yield CsiBlock.concatenate(blocks)


def _print(recording: Path, method: str, figures: dict[str, Any], remark: str) -> None:
    print(f"{recording}: {figures['frames']} frames of {figures['ues']} UEs, {method}")
    for reason, count in figures["rejected"].items():
        print(f"rejected  {count} ({reason})")
    if figures["tw"] is None:
        print(f"quality   {remark}")
    else:
        print(f"TW        {figures['tw']:.4f}  (K = {figures['k']})")
        print(f"CT        {figures['ct']:.4f}")
        print(f"stress    {figures['stress']:.4f}")
        errors = [figures[name] for name in ("error_m", "error_mean_m", "error_p90_m")]
        print("error     {:.2f} m median, {:.2f} m mean, {:.2f} m for 90 %".format(*errors))
    rate = figures["frames"] / figures["seconds"]
    print(f"seconds   {figures['seconds']:.2f}  ({rate:.0f} frames/s)")
