"""What `chachart evaluate` does with several arrays, and with UEs that are tracked."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.config.load import NodeSettings
from chachart.node.commands.shared import refining
from chachart.node.commands.shared.cli import progress
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.estimation.fusion.options import FusionOptions
from chachart.node.estimation.quality import neighbourhoods
from chachart.node.estimation.tracking.smoother import Logbook
from chachart.node.files.placements import load_placements
from chachart.node.files.recording import RecordingReader

OUTLIER_M = 10.0


def estimator_of(reader: RecordingReader, settings: NodeSettings) -> FusedEstimator:
    """An estimator for all arrays of a recording; where UEs can be is the recording's word, if it has one.

    Raises
    ------
    SetupError
        If a setting does not fit the arrays.
    """
    fusion = settings.fusion
    area = reader.note.get("area_m")
    if area is not None and fusion.area_m is None and fusion.outline_m is None:
        fusion = FusionOptions.model_validate({**fusion.model_dump(), "area_m": tuple(area)})
    try:
        placements = () if fusion.calibration is None else load_placements(Path(fusion.calibration))
        options = settings.estimator.obeying(reader.facts)
        return FusedEstimator(reader.arrays, fusion, settings.tracking, options, placements)
    except ValueError as error:
        raise SetupError(f"[fusion]: {error}") from None


def run(arguments: argparse.Namespace, reader: RecordingReader, settings: NodeSettings) -> int:
    """Fuse a recording and say how good every single position is.

    Raises
    ------
    SetupError
        If a setting does not fit, or no position is known.
    """
    if arguments.chart is not None:
        raise SetupError("--chart draws the chart of one array without tracking")
    estimator = estimator_of(reader, settings)
    if arguments.smooth:
        if estimator.tracker is None:
            raise SetupError("--smooth needs tracks: --set tracking.motion=walk or drive")
        if settings.tracking.lag:
            raise SetupError("--smooth and tracking.lag exclude each other")
        estimator.logbook = Logbook()
    witness = _witness(estimator) if arguments.refine else None
    rows: list[ChartUpdate] = []
    started = time.perf_counter()
    frames = 0
    with progress("charting", reader.summary().frames) as advance:
        for block in reader.blocks():
            rows += estimator.every(block)
            frames += len(block)
            advance(len(block))
    rows += estimator.every(None)
    if not rows:
        raise SetupError(f"{reader.path}: no frame could be used, of {frames}")
    figures: dict[str, Any] = {
        "frames": frames,
        "ues": estimator.ues,
        "positions": sum(map(len, rows)),
        "clock": estimator.clock,
        "motion": settings.tracking.motion,
        "heard": estimator.heard.as_dict(),
        "rejected": estimator.rejected.as_dict() | reader.damaged.as_dict(),
    }
    found = np.concatenate([np.column_stack([row.x, row.y]) for row in rows])
    if estimator.logbook is not None and estimator.tracker is not None:
        found = estimator.logbook.smoothed(estimator.tracker.motions)[0][:, :2]
        figures["smoothed"] = True
    figures["seconds"] = time.perf_counter() - started
    figures |= _errors(rows, found, settings)
    if witness is not None:
        outlier, truth = (np.concatenate([row[name] for row in rows]) for name in ("outlier", "position"))
        better = witness.refined(found, outlier)
        quality = settings.quality
        figures["refined"] = refining.figures(better, truth[:, :2], quality.k, quality.exact_ues)
    _print(arguments, figures)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


def _witness(estimator: FusedEstimator) -> refining.Witness:
    if estimator.tracker is not None:
        raise SetupError("--refine and tracks exclude each other: --set tracking.motion=off")
    witness = refining.Witness([receiver.site for receiver in estimator.receivers], estimator.clock)
    estimator.witness = witness
    return witness


def _errors(rows: list[ChartUpdate], found: NDArray[Any], settings: NodeSettings) -> dict[str, Any]:
    """Of all positions (K, 2) of which the truth is known."""
    truth = np.concatenate([row["position"] for row in rows]).astype(np.float64)
    known = np.isfinite(truth).all(axis=1) & np.isfinite(found).all(axis=1)
    if known.sum() < 8:
        return {"error_m": None}
    off = found[known] - truth[known, :2]
    error = np.linalg.norm(off, axis=1)
    figures: dict[str, Any] = {
        "error_m": float(np.median(error)),
        "error_mean_m": float(error.mean()),
        "error_p90_m": float(np.quantile(error, 0.9)),
    }
    sampled = np.random.default_rng(0) if len(error) > settings.quality.exact_ues else None
    near = neighbourhoods(truth[known, :2], found[known], settings.quality.k, rng=sampled)
    figures |= {"tw": near.tw, "ct": near.ct, "k": near.k}
    outlier = np.concatenate([row["outlier"] for row in rows])[known]
    figures["outliers"] = float(np.mean(error > OUTLIER_M))
    figures["outlier_auc"] = _auc(outlier, error > OUTLIER_M)
    xx, xy, yy = (np.concatenate([row[n] for row in rows])[known] for n in ("x_var", "xy_cov", "y_var"))
    square = (yy * off[:, 0] ** 2 - 2 * xy * off[:, 0] * off[:, 1] + xx * off[:, 1] ** 2) / (xx * yy - xy**2)
    figures["normalised_error"] = float(square.mean() / 2)
    return figures


def _auc(score: NDArray[Any], positive: NDArray[np.bool_]) -> float | None:
    """Probability that a positive one has the larger score."""
    count = int(positive.sum())
    if count in (0, len(positive)):
        return None
    ranks = np.empty(len(score))
    ranks[np.argsort(score, kind="stable")] = np.arange(1, len(score) + 1)
    above = float(ranks[positive].sum()) - count * (count + 1) / 2
    return above / (count * (len(score) - count))


def _print(arguments: argparse.Namespace, figures: dict[str, Any]) -> None:
    print(
        f"{arguments.recording}: {figures['frames']} frames of {figures['ues']} UEs, "
        f"{figures['positions']} positions"
    )
    heard = ", ".join(f"{name} {count}" for name, count in figures["heard"].items())
    smoothed = ", smoothed" if figures.get("smoothed") else ""
    print(f"arrays    {heard} frames; clock {figures['clock']}; motion {figures['motion']}{smoothed}")
    for reason, count in figures["rejected"].items():
        print(f"rejected  {count} ({reason})")
    if figures["error_m"] is None:
        print("quality   no position is known: nothing to compare with")
    else:
        print(f"TW        {figures['tw']:.4f}  (K = {figures['k']})")
        print(f"CT        {figures['ct']:.4f}")
        print(
            f"error     {figures['error_m']:.3f} m median, {figures['error_mean_m']:.2f} m mean, "
            f"{figures['error_p90_m']:.2f} m for 90 %"
        )
        auc = figures["outlier_auc"]
        told = "" if auc is None else f", told from the others with an AUC of {auc:.3f}"
        print(f"outliers  {100 * figures['outliers']:.1f} % are more than {OUTLIER_M:.0f} m off{told}")
        if not smoothed:
            print(f"honesty   {figures['normalised_error']:.2f} mean squared error by stated variance")
    if "refined" in figures:
        refining.say(figures["refined"])
    rate = figures["positions"] / figures["seconds"]
    print(f"seconds   {figures['seconds']:.2f}  ({rate:.0f} positions/s)")
