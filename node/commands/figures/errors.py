"""Where in the plane a chart is how wrong."""

from __future__ import annotations

import argparse

import numpy as np
from matplotlib.figure import Figure

from chachart.node.commands.figures.style import WIDTH_IN, limits, new_figure
from chachart.node.commands.shared.charting import Charted, charted
from chachart.node.estimation.similarity import best_fit, errors_as_they_are

WORST_SHARE = 98.0
"""Errors above this percentile share the last colour."""


def figure(arguments: argparse.Namespace) -> Figure:
    """The error map of the files' chart."""
    return draw(charted(arguments))


def draw(what: Charted) -> Figure:
    """Every UE at its true position, coloured by how far off the chart has it.

    The error is that of `chachart evaluate`, as it is; the title also says what the best fit would leave.

    Raises
    ------
    SetupError
        If too few positions are known.
    """
    truth, chart = what.known()
    errors = errors_as_they_are(truth, chart)
    fitted = float(np.median(best_fit(truth, chart).errors_m))
    order = np.argsort(errors)  # the worst on top
    x_limits, y_limits = (limits(column) for column in truth.T)
    shape = (y_limits[1] - y_limits[0]) / (x_limits[1] - x_limits[0])
    p90 = np.percentile(errors, 90)
    title = f"{what.name}\nmedian {np.median(errors):.3g} m, 90 % below {p90:.3g} m, fitted {fitted:.3g} m"
    drawn = new_figure(float(np.clip((WIDTH_IN - 1.6) * shape + 0.8, 2.0, 4.2)), title)
    axes = drawn.add_subplot()
    size = float(np.clip(8000 / len(truth), 1.0, 16))
    points = axes.scatter(
        truth[order, 0],
        truth[order, 1],
        s=size,
        c=errors[order],
        cmap="viridis",
        vmin=0,
        vmax=max(float(np.percentile(errors, WORST_SHARE)), 1e-9),
        linewidths=0,
        rasterized=True,
    )
    axes.plot(0, 0, marker="^", color="black", markersize=4)
    axes.set(xlabel="true x along broadside (m)", ylabel="true y along the array (m)", aspect="equal")
    axes.set(xlim=x_limits, ylim=y_limits)
    drawn.colorbar(points, ax=axes, label="position error (m)", extend="max", aspect=30)
    return drawn
