"""Trustworthiness and continuity: against the number of neighbours, and over time."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from chachart.node.commands.figures.style import BLUE, ORANGE, new_figure, share, share_axis, share_limits
from chachart.node.commands.shared.charting import Charted, charted
from chachart.node.data.errors import SetupError
from chachart.node.estimation.curves import neighbour_ranks, neighbourhood_curves
from chachart.node.estimation.quality import DEFAULT_K_SHARE
from chachart.node.files.chart_log import ChartLogReader, is_chart_log
from chachart.node.files.mcap_chunks import MAGIC

MOST_UES = 4096
"""Of more, so many drawn at random stand for all: ranks take memory with the square."""
MOST_K_SHARE = 0.1
"""Curves go to so many neighbours, of all UEs."""
PANEL_IN = 1.9

Report = dict[str, Any]


def figure(arguments: argparse.Namespace) -> Figure:
    """The curve of a recording; of a chart log the curve and its course; of a quality log its course.

    Raises
    ------
    SetupError
        If a file is none of these, or holds neither.
    """
    paths: list[Path] = arguments.files
    if (reports := _quality_log(paths)) is not None:
        return draw(None, reports, paths[0].name)
    what = charted(arguments)
    reports = []
    if is_chart_log(paths[0]):
        reports = [report for path in paths for report in ChartLogReader(path).quality()]
    return draw(what, _usable(reports), what.name)


def draw(what: Charted | None, reports: list[Report], title: str) -> Figure:
    """A panel for the curves of a chart, if there is one, and one for reports over time, if there are any."""
    panels = (what is not None) + bool(reports)
    drawn = new_figure(0.4 + PANEL_IN * panels, title)
    if what is not None:
        _against_k(drawn.add_subplot(panels, 1, 1), what)
    if reports:
        _over_time(drawn.add_subplot(panels, 1, panels), reports)
    return drawn


def _against_k(axes: Axes, what: Charted) -> None:
    truth, chart = what.known()
    of = f"{len(truth)} UEs"
    if len(truth) > MOST_UES:
        of = f"{MOST_UES} UEs drawn from {len(truth)}"
        pick = np.random.default_rng(0).choice(len(truth), MOST_UES, replace=False)
        truth, chart = truth[pick], chart[pick]
    most = max(1, min(round(MOST_K_SHARE * len(truth)), (len(truth) - 1) // 2))
    tw, ct = neighbourhood_curves(neighbour_ranks(truth), neighbour_ranks(chart), most)
    k = np.arange(1, most + 1)
    usual = min(max(round(DEFAULT_K_SHARE * len(truth)), 1), most)
    for name, values, colour, line in (("TW", tw, BLUE, "-"), ("CT", ct, ORANGE, "--")):
        label = f"{name}, {values[usual - 1]:.4f} at K = {usual}"
        axes.plot(k, share(values), line, color=colour, label=label)
        axes.plot(usual, share(values[usual - 1 : usual])[0], "o", color=colour, markersize=3.5)
    share_axis(axes, "y")
    axes.set(xlabel=f"neighbours K of {of}", ylabel="TW, CT", xlim=(0, most + 1), ylim=share_limits(tw, ct))
    axes.legend()


def _over_time(axes: Axes, reports: list[Report]) -> None:
    times = np.array([report["time_ns"] for report in reports], np.int64)
    seconds = (times - times[0]) / 1e9
    tw, ct = (np.array([report[name] for report in reports], np.float64) for name in ("tw", "ct"))
    axes.plot(seconds, share(tw), "o-", color=BLUE, markersize=2.5, label="TW")
    axes.plot(seconds, share(ct), "s--", color=ORANGE, markersize=2.5, label="CT")
    share_axis(axes, "y")
    unit, scale = ("h", 3600.0) if seconds[-1] > 7200 else ("min", 60.0) if seconds[-1] > 180 else ("s", 1.0)
    axes.xaxis.set_major_formatter(lambda second, _: f"{second / scale:g}")
    ks = sorted({report["k"] for report in reports if report.get("k")})
    neighbours = f"TW, CT at K = {ks[0]}" + (f" to {ks[-1]}" if len(ks) > 1 else "") if ks else "TW, CT"
    axes.set(xlabel=f"time since the first report ({unit})", ylabel=neighbours, ylim=share_limits(tw, ct))
    axes.legend()


def _quality_log(paths: list[Path]) -> list[Report] | None:
    """The reports in JSON lines; None where the first file is something else."""
    reports: list[Any] = []
    for path in paths:
        try:
            with path.open("rb") as file:
                if file.read(len(MAGIC)) == MAGIC:
                    return None
            reports += [json.loads(line) for line in path.read_text("utf-8").splitlines() if line.strip()]
        except OSError as error:
            raise SetupError(f"cannot read {path}: {error.strerror}") from None
        except ValueError:
            return None
    usable = _usable(reports)
    if not usable:
        raise SetupError(f"{paths[0]} holds no quality reports")
    return usable


def _usable(reports: list[Any]) -> list[Report]:
    """Those with a time, TW and CT, in the order of time."""
    numbers = ("time_ns", "tw", "ct")
    usable = [
        report
        for report in reports
        if isinstance(report, dict) and all(type(report.get(name)) in (int, float) for name in numbers)
    ]
    return sorted(usable, key=lambda report: report["time_ns"])
