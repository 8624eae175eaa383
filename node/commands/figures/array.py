"""An array as seen from in front and from above: elements with numbers, its vectors, its field of view."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Wedge

from chachart.node.commands.figures.style import BLUE, GREEN, INK, ORANGE, new_figure
from chachart.node.data.geometry import ArrayGeometry

NUMBERS = 128
"""With more elements, only some of their numbers are written."""


def draw(array: ArrayGeometry) -> Figure:
    """The array in its own frame: right and up on the left, right and normal on the right."""
    drawn = new_figure(2.6, f"{array.name}, as seen by a UE in front of it")
    front, above = drawn.subplots(1, 2)
    own = array.own_elements
    size = max(float(np.abs(own).max()), array.wavelength_m / 4)
    _elements(front, own[:, 0], own[:, 1], size)
    front.set(title="from in front", xlabel="right (m)", ylabel="up (m)")
    _elements(above, own[:, 0], own[:, 2], size)
    above.set(title="from above", xlabel="right (m)", ylabel="normal (m)")
    _arrow(above, (0, 1.7 * size), "normal", GREEN)
    facing = array.facing
    if facing is None or facing[2] <= 0.5:
        start, end = (0, 180) if array.is_line else (0, 360)
    else:
        start, end = 0, 180
    above.add_patch(Wedge((0, 0), 1.5 * size, start, end, color=GREEN, alpha=0.12, linewidth=0))
    for axes in (front, above):
        _arrow(axes, (1.7 * size, 0), "right", ORANGE)
        axes.set_aspect("equal")
        axes.set(xlim=(-2.2 * size, 2.2 * size), ylim=(-2.2 * size, 2.2 * size))
    _arrow(front, (0, 1.7 * size), "up", BLUE)
    return drawn


def _elements(axes: Axes, x: Any, y: Any, size: float) -> None:
    axes.plot(x, y, "o", color=INK, markersize=3)
    names: dict[tuple[int, int], list[int]] = {}
    for number in range(0, len(x), max(1, len(x) // NUMBERS)):
        place = (round(200 * x[number] / size), round(200 * y[number] / size))
        names.setdefault(place, []).append(number)
    for numbers in names.values():
        text = ",".join(map(str, numbers[:3])) + ("…" if len(numbers) > 3 else "")
        at = (x[numbers[0]], y[numbers[0]])
        axes.annotate(text, at, (2, 2), textcoords="offset points", fontsize=5)


def _arrow(axes: Axes, tip: tuple[float, float], name: str, colour: str) -> None:
    axes.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour})
    axes.annotate(name, tip, (3, 3), textcoords="offset points", color=colour, fontsize=6)
