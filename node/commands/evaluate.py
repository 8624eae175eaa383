"""Chart a recording in this process, as fast as it goes, and say how good the chart is.

    chachart evaluate capture.mcap --theta music --rho music --chart chart.png --json quality.json
    chachart evaluate capture.mcap --set estimator.averaging=exponential estimator.memory_frames=16

Recordings of several arrays are fused, as [fusion] and [tracking] say:

    chachart evaluate street.mcap --set fusion.clock=offset
    chachart evaluate walk.mcap --set tracking.motion=walk --smooth

UEs whose own frames leave doubt can go where UEs with channels like theirs are; figures are of both charts:

    chachart evaluate street.mcap --refine

All frames of a UE count alike unless --set says otherwise. Methods that are not named are those that the
capture allows. Errors are given as they are, in metres in the frame of the positions, and after the turn,
mirror, scale and shift that fit best, which say what kind of error it is.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from chachart.config.load import NodeSettings
from chachart.node.commands.shared import fused, refining
from chachart.node.commands.shared.charting import (
    FEWEST_UES,
    Charted,
    add_options,
    estimate,
    estimator_for,
    methods_for,
    settings_for,
)
from chachart.node.commands.shared.cli import check_figure, check_writable
from chachart.node.commands.shared.tables import as_csv, as_latex
from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.options import AMPLITUDE
from chachart.node.estimation.quality import assess
from chachart.node.estimation.similarity import in_degrees
from chachart.node.files.recording import RecordingReader

_SHARES = ("tw", "ct", "k", "stress")
_ERRORS = ("error_m", "error_mean_m", "error_p90_m")
_ANGLES = ("theta_error_deg", "rho_error_m")

_TABLES = {".csv": as_csv, ".tex": as_latex}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart evaluate`."""
    parser.add_argument("recording", type=Path, metavar="FILE.mcap", help="the recording")
    add_options(parser)
    parser.add_argument("--chart", type=Path, metavar="FILE.png", help="draw truth and chart side by side")
    parser.add_argument("--smooth", action="store_true", help="with tracking: what comes later counts, too")
    parser.add_argument(
        "--refine", action="store_true", help="move doubtful UEs to where UEs with channels like theirs are"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument(
        "--table",
        type=Path,
        metavar="FILE",
        help="write the figures as a row of a .csv or .tex table",
    )


def run(arguments: argparse.Namespace) -> int:
    """Evaluate the recording.

    Raises
    ------
    SetupError
        If the recording or a setting does not fit.
    """
    if arguments.json is not None:
        check_writable(arguments.json, force=True)
    if arguments.table is not None:
        if arguments.table.suffix not in _TABLES:
            raise SetupError(f"{arguments.table} must end in one of {', '.join(_TABLES)}")
        check_writable(arguments.table, force=True)
    if arguments.chart is not None:
        check_figure(arguments.chart)
        require("plot", "--chart:")
    reader = RecordingReader(arguments.recording)
    settings = settings_for(arguments, reader)
    if len(reader.arrays) > 1 or settings.tracking.motion != "off":
        return fused.run(arguments, reader, settings)
    if arguments.smooth:
        raise SetupError("--smooth needs tracks: --set tracking.motion=walk or drive")
    estimator = estimator_for(reader, settings, arguments.calibration)
    started = time.perf_counter()
    chart, frames = estimate(reader, estimator)
    seconds = time.perf_counter() - started
    figures: dict[str, Any] = dict.fromkeys((*_SHARES, *_ERRORS, *_ANGLES))
    figures |= {
        "seconds": seconds,
        "frames": frames,
        "ues": len(chart),
        "rejected": estimator.rejected.as_dict() | reader.damaged.as_dict(),
        "theta": estimator.method.theta,
        "rho": estimator.method.rho,
        "chosen_because": _chosen(arguments, reader),
        "warnings": [],
    }
    compared, remark = _compared(chart, reader, estimator.method, settings)
    figures |= compared
    if arguments.refine:
        better = refining.refined(reader, chart, estimator.array)
        truth = np.stack(chart.truth_of(reader.array), axis=1)
        figures["refined"] = refining.figures(better, truth, settings.quality.k, settings.quality.exact_ues)
        chart = chart.with_columns(x=better.place[:, 0], y=better.place[:, 1])
    method = f"{estimator.method.theta}/{estimator.method.rho}"
    _print(arguments.recording, method, figures, remark)
    _write(arguments, method, figures)
    if arguments.chart is not None:
        from chachart.node.commands.figures import chart as picture
        from chachart.node.commands.figures.style import write

        refined = ", refined" if arguments.refine else ""
        charted = Charted(chart, reader.array, f"{arguments.recording.name}, {method}{refined}")
        write(arguments.chart, lambda: picture.draw(charted))
    return 0


def _compared(
    chart: ChartUpdate, reader: RecordingReader, method: Method, settings: NodeSettings
) -> tuple[dict[str, Any], str]:
    """Figures from the UEs whose positions are known, and what to say where there are none."""
    known = np.zeros(0) if chart.position is None else np.flatnonzero(np.isfinite(chart.position).all(axis=1))
    nothing = f"only {len(known)} UEs have a known position: nothing to compare with"
    if not len(known):
        return {}, nothing
    told = chart.take(known)
    assert told.position is not None
    if in_degrees(told.position):
        raise SetupError(
            f"{reader.path}: the known positions lie within a centimetre of one another: they look like "
            "degrees (import them again with --position-unit deg)"
        )
    figures = _one_coordinate_each(told, reader.array)
    if method.rho in AMPLITUDE and len(known) < FEWEST_UES and settings.estimator.isq_reference is None:
        figures["rho_error_m"] = None  # these very places have set the scale
    if "none" in (method.theta, method.rho) and "z" not in told.columns:
        return figures, "one coordinate alone is no place: only its own error counts"
    if len(known) < FEWEST_UES:
        return figures, nothing
    try:
        of_chart = assess(told, reader.array, settings.quality.k, settings.quality.exact_ues)
    except ValueError as error:
        return figures, str(error)
    return {**figures, **of_chart, "ues": len(chart)}, nothing


def _write(arguments: argparse.Namespace, method: str, figures: dict[str, Any]) -> None:
    """The figures to the files that were asked for."""
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
    if arguments.table is not None:
        row = {"recording": arguments.recording.name, "methods": method}
        row |= {name: value for name, value in figures.items() if not isinstance(value, dict)}
        arguments.table.write_text(_TABLES[arguments.table.suffix]([row]))


def _chosen(arguments: argparse.Namespace, reader: RecordingReader) -> str:
    """Why the methods are not the usual ones, where nobody chose them."""
    if arguments.theta is not None and arguments.rho is not None:
        return ""
    return methods_for(reader.array, reader.facts)[2]


def _one_coordinate_each(chart: ChartUpdate, array: ArrayGeometry) -> dict[str, Any]:
    """Median errors of directions and of distances, where there are any."""
    assert chart.position is not None
    theta, rho = array.theta_rho(chart.position)
    found: dict[str, Any] = {}
    for name, errors in (
        ("theta_error_deg", np.degrees(chart.theta - theta)),
        ("rho_error_m", chart.rho - rho),
    ):
        finite = np.abs(errors[np.isfinite(errors)])
        method = chart.method.theta if name.startswith("theta") else chart.method.rho
        found[name] = float(np.median(finite)) if len(finite) and method != "none" else None
    return found


def _print(recording: Path, method: str, figures: dict[str, Any], remark: str) -> None:
    print(f"{recording}: {figures['frames']} frames of {figures['ues']} UEs, {method}")
    if figures["chosen_because"]:
        print(f"methods   chosen by what the capture allows: {figures['chosen_because']}")
    for reason, count in figures["rejected"].items():
        print(f"rejected  {count} ({reason})")
    if figures["tw"] is None:
        print(f"quality   {remark}")
    else:
        print(f"TW        {figures['tw']:.4f}  (K = {figures['k']})")
        print(f"CT        {figures['ct']:.4f}")
        print(f"stress    {figures['stress']:.4f}")
        for name, prefix in (("error", ""), ("fitted", "fit_")):
            errors = [figures[prefix + error] for error in _ERRORS]
            told = "as it is" if not prefix else _fit(figures)
            median, mean, p90 = errors
            print(f"{name:<9} {median:.2f} m median, {mean:.2f} m mean, {p90:.2f} m for 90 % ({told})")
    if figures["theta_error_deg"] is not None:
        print(f"direction {figures['theta_error_deg']:.2f} degrees off, median")
    if figures["rho_error_m"] is not None:
        print(f"distance  {figures['rho_error_m']:.2f} m off, median")
    if "refined" in figures:
        refining.say(figures["refined"])
    for warning in figures["warnings"]:
        print(f"warning   {warning}")
    rate = figures["frames"] / figures["seconds"]
    print(f"seconds   {figures['seconds']:.2f}  ({rate:.0f} frames/s)")


def _fit(figures: dict[str, Any]) -> str:
    """The best fit in words."""
    mirrored = "mirrored, " if figures["fit_mirrored"] else ""
    return (
        f"after the best fit: {mirrored}turned by {figures['fit_turn_deg']:.1f} degrees, "
        f"scaled by {figures['fit_scale']:.3f}, "
        f"shifted by ({figures['fit_shift_x_m']:.2f}, {figures['fit_shift_y_m']:.2f}) m"
    )
