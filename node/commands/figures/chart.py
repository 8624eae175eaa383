"""A chart beside the truth, each UE coloured by its true position."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from chachart.node.commands.figures.style import WIDTH_IN, limits, new_figure
from chachart.node.commands.shared.charting import Charted, charted

COMPARABLE = 3.0
"""Truth and chart have the same limits unless one is so many times larger."""

_UNKNOWN = (0.6, 0.6, 0.6)
# The colours of the live view: along y from the first to the last, lighter the farther away.
_NEAR = ("#2743c9", "#a8328f", "#c04a00")
_FAR = ("#7fc4ff", "#f39ac7", "#ffd257")
_DEPTHS = (0.1, 0.85)


def figure(arguments: argparse.Namespace) -> Figure:
    """The chart of the files."""
    return draw(charted(arguments))


def draw(what: Charted) -> Figure:
    """Truth and chart side by side, to one scale where they are comparable.

    UEs whose position is not known are grey, and in the chart only.
    """
    chart = what.chart
    true_x, true_y = np.full((2, len(chart)), np.nan)
    if chart.position is not None:
        true_x, true_y = chart.truth_of(what.array)
    known = np.isfinite(true_x) & np.isfinite(true_y)
    colours = position_colours(true_x, true_y, known)
    everyone = np.ones(len(chart), bool)
    panels = [("channel chart", chart.x, chart.y, everyone)]
    if known.any():
        panels.insert(0, ("true positions", true_x, true_y, known))
    frames = [(limits(x[shown]), limits(y[shown])) for _, x, y, shown in panels]
    spans = np.array([[high - low for low, high in frame] for frame in frames])
    comparable = bool((spans.max(axis=0) < COMPARABLE * spans.min(axis=0)).all())
    if comparable:
        frames = [_around(frames)] * len(panels)
        spans = np.array([[high - low for low, high in frames[0]]])
    shape = float((spans[:, 1] / spans[:, 0]).max())
    drawn = new_figure(float(np.clip((WIDTH_IN - 0.7) / len(panels) * shape + 0.7, 2.0, 4.5)), what.name)
    size = float(np.clip(4000 / len(chart), 0.6, 12))
    for i, ((title, x, y, shown), frame) in enumerate(zip(panels, frames, strict=True)):
        axes = drawn.add_subplot(1, len(panels), i + 1)
        axes.scatter(x[shown], y[shown], s=size, c=colours[shown], linewidths=0, rasterized=True)
        axes.plot(0, 0, marker="^", color="black", markersize=4)
        (left, right), (bottom, top) = frame
        outside = np.count_nonzero(shown & ((x < left) | (x > right) | (y < bottom) | (y > top)))
        title += f", {outside} outside" * bool(outside)
        axes.set(title=title, xlabel="x along broadside (m)", aspect="equal", xlim=frame[0], ylim=frame[1])
        if i == 0:
            axes.set_ylabel("y along the array (m)")
        elif comparable:
            axes.tick_params(labelleft=False)
    return drawn


def position_colours(x: NDArray[Any], y: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """RGB (K, 3): blue to orange along y, lighter along x; grey where not known."""
    colours = np.full((len(x), 3), _UNKNOWN)
    if known.any():
        depth, along = (_unit(values[known])[:, None] for values in (x, y))
        depth = _DEPTHS[0] + (_DEPTHS[1] - _DEPTHS[0]) * depth
        near, far = (
            np.stack([np.interp(along[:, 0], [0, 0.5, 1], stop) for stop in _linear(stops).T], axis=1)
            for stops in (_NEAR, _FAR)
        )
        # Mixed as light is, so that the steps look even.
        colours[known] = (near + depth * (far - near)) ** (1 / 2.2)
    return colours


def _linear(stops: tuple[str, ...]) -> NDArray[np.float64]:
    rgb = [[int(stop[i : i + 2], 16) / 255 for i in (1, 3, 5)] for stop in stops]
    linear: NDArray[np.float64] = np.array(rgb) ** 2.2
    return linear


def _unit(values: NDArray[Any]) -> NDArray[Any]:
    spread = np.ptp(values)
    unit: NDArray[Any] = (values - values.min()) / (spread if spread > 0 else 1.0)
    return unit


def _around(frames: list[Any]) -> Any:
    """The least limits that hold all of them."""
    return tuple((min(f[i][0] for f in frames), max(f[i][1] for f in frames)) for i in (0, 1))
