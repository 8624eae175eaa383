"""How figures look: as wide as a paper's column, nothing below 7 points, safe for the colour blind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from chachart.node.commands.shared.cli import written_whole
from chachart.node.data.errors import SetupError

WIDTH_IN = 3.5
DPI = 300
TITLE_LETTERS = 52
BLUE, ORANGE, GREEN, PURPLE, INK = "#0072b2", "#d55e00", "#009e73", "#b0569b", "#1b1f24"
"""Of Okabe and Ito's palette, darkened where thin lines need it."""
LEAST_SHARE = 2e-5
"""1 - TW and 1 - CT are drawn as at least so much: a logarithmic axis has no zero."""

_STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "figure.titlesize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "chachart",
}
# Without dates and random names, the same chart gives the same file.
_DATELESS = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def write(path: Path, make: Callable[[], Figure]) -> None:
    """Draw a figure and write it as the kind that the file's name says.

    Raises
    ------
    SetupError
        If it cannot be written, or matplotlib does not know the kind.
    """
    kind = path.suffix.lower()
    with mpl.rc_context(_STYLE), written_whole(path) as part:
        figure = make()
        FigureCanvasAgg(figure)
        try:
            figure.savefig(part, format=kind[1:] or "png", dpi=DPI, metadata=_DATELESS.get(kind))
        except ValueError as error:
            raise SetupError(f"{path} cannot be written: {error}") from None


def new_figure(height_in: float, title: str = "") -> Figure:
    """An empty figure of a column's width; a long title takes several lines."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    figure.suptitle("\n".join(fill(line, TITLE_LETTERS) for line in title.splitlines()))
    return figure


def share(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """What is missing to 1, as `share_axis` draws it."""
    return np.maximum(1 - values, LEAST_SHARE)


def share_axis(axes: Axes, which: str) -> None:
    """A logarithmic axis of 1 - TW that reads as TW and grows towards 1."""
    scale: Any = axes.set_yscale if which == "y" else axes.set_xscale
    scale("log")
    axis: Any = axes.yaxis if which == "y" else axes.xaxis
    axis.set_inverted(True)
    low, high = sorted(axis.get_view_interval())
    wide = which == "x" and high > 30 * low  # more marks would run into each other
    axis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{1 - v:.6f}".rstrip("0").removeprefix("0")))
    axes.grid(True, which="major")


def share_limits(*curves: NDArray[np.float64]) -> tuple[float, float]:
    """Limits of a `share_axis` at marks of it beyond all of the curves, the worse first."""
    values = share(np.concatenate(curves))
    marks = np.outer(10.0 ** np.arange(-6, 2), (1.0, 2.0, 5.0)).ravel()
    return float(marks[marks > values.max()].min()), float(marks[marks < values.min()].max())


def limits(values: NDArray[Any]) -> tuple[float, float]:
    """Limits that show the array, at 0, and nearly all values; a few outliers do not shrink the rest."""
    low, high = np.percentile(np.append(values, 0.0), [0.5, 99.5])
    margin = 0.05 * max(high - low, 1e-9)
    return min(low, 0.0) - margin, max(high, 0.0) + margin
