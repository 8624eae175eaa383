"""Chart a recording in this process, as fast as it goes, and say how good the chart is.

    chachart evaluate capture.mcap --theta music --rho music --chart chart.png --json quality.json
    chachart evaluate capture.mcap --set estimator.averaging=exponential estimator.memory_frames=16

All frames of a UE count alike unless --set says otherwise.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from chachart.node.commands.shared.charting import (
    FEWEST_UES,
    Charted,
    add_options,
    estimate,
    estimator_for,
    settings_for,
)
from chachart.node.commands.shared.cli import check_figure, check_writable
from chachart.node.data.extras import require
from chachart.node.estimation.quality import assess
from chachart.node.files.recording import RecordingReader


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart evaluate`."""
    parser.add_argument("recording", type=Path, metavar="FILE.mcap", help="the recording")
    add_options(parser)
    parser.add_argument("--chart", type=Path, metavar="FILE.png", help="draw truth and chart side by side")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate the recording.

    Raises
    ------
    SetupError
        If the recording or a setting does not fit.
    """
    if arguments.json is not None:
        check_writable(arguments.json, force=True)
    if arguments.chart is not None:
        check_figure(arguments.chart)
        require("plot", "--chart:")
    settings = settings_for(arguments, arguments.recording)
    reader = RecordingReader(arguments.recording)
    estimator = estimator_for(reader, settings, arguments.calibration)
    started = time.perf_counter()
    chart, frames = estimate(reader, estimator)
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
        from chachart.node.commands.figures import chart as picture
        from chachart.node.commands.figures.style import write

        charted = Charted(chart, reader.array, f"{arguments.recording.name}, {method}")
        write(arguments.chart, lambda: picture.draw(charted))
    return 0


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
