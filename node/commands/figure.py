"""A chart beside the truth, as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from chachart.node.chart import ChartUpdate
from chachart.node.errors import SetupError
from chachart.node.geometry import ArrayGeometry

_UNKNOWN = (0.6, 0.6, 0.6)


def draw(path: Path, chart: ChartUpdate, array: ArrayGeometry, title: str) -> None:
    """Write truth and chart side by side, each UE coloured by its true position.

    UEs whose position is not known are grey, and in the chart only.

    Raises
    ------
    SetupError
        If the file cannot be written.
    """
    true_x, true_y = np.full((2, len(chart)), np.nan)
    if chart.position is not None:
        true_x, true_y = array.chart_of(chart.position)
    known = np.isfinite(true_x) & np.isfinite(true_y)
    colours = position_colours(true_x, true_y, known)
    width, height = (np.ptp(np.percentile(np.append(v, 0.0), [0.5, 99.5])) for v in (chart.x, chart.y))
    aspect = float(np.clip(width / max(height, 1e-9), 0.5, 1.5))
    figure = Figure(figsize=(2 * 5.5 * aspect + 2, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    left, right = figure.subplots(1, 2)
    size = float(np.clip(30_000 / max(len(chart), 1), 2, 40))
    for axes, name, x, y, shown in (
        (left, "true positions", true_x, true_y, known),
        (right, "channel chart", chart.x, chart.y, np.ones(len(chart), bool)),
    ):
        axes.scatter(x[shown], y[shown], s=size, c=colours[shown], linewidths=0)
        axes.plot(0, 0, marker="^", color="black", markersize=8)
        axes.set(title=name, xlabel="x along broadside (m)", ylabel="y along the array (m)", aspect="equal")
        axes.grid(alpha=0.2)
    _frame(right, chart.x, chart.y)
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise SetupError(f"{path} cannot be written: {error}") from None


def position_colours(x: NDArray[Any], y: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """RGB (K, 3): the hue goes along y, light and pale along x."""
    colours = np.full((len(x), 3), _UNKNOWN)
    if known.any():
        u, v = (_unit(values[known]) for values in (x, y))
        colours[known] = hsv_to_rgb(np.stack([0.8 * v, 1 - 0.45 * u, 0.65 + 0.3 * u], axis=1))
    return colours


def _unit(values: NDArray[Any]) -> NDArray[Any]:
    spread = np.ptp(values)
    unit: NDArray[Any] = (values - values.min()) / (spread if spread > 0 else 1.0)
    return unit


def _frame(axes: Any, x: NDArray[Any], y: NDArray[Any]) -> None:
    """Limits that show the array and nearly all UEs; a few outliers do not shrink the rest."""
    for values, set_limits in ((x, axes.set_xlim), (y, axes.set_ylim)):
        low, high = np.percentile(np.append(values, 0.0), [0.5, 99.5])
        margin = 0.08 * max(high - low, 1e-9)
        set_limits(min(low, 0.0) - margin, max(high, 0.0) + margin)
