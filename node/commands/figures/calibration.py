"""Phase and gain of each antenna, as calibrations have them."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from chachart.node.commands.figures.style import BLUE, GREEN, INK, ORANGE, PURPLE, new_figure
from chachart.node.data.calibration import Calibration
from chachart.node.data.errors import SetupError
from chachart.node.files.calibration import load_calibration
from chachart.node.files.recording import RecordingReader

APART = 0.2
"""Of several calibrations, the first is drawn so far left of the element and the last so far right."""

_LOOKS = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (PURPLE, "D"))


def figure(arguments: argparse.Namespace) -> Figure:
    """The calibrations in up to four files, calibration files or recordings that hold one.

    Raises
    ------
    SetupError
        If a file holds none, or there are too many files.
    """
    if len(arguments.files) > len(_LOOKS):
        raise SetupError(f"at most {len(_LOOKS)} calibrations in a figure, not {len(arguments.files)}")
    return draw({path.name: _calibration(path) for path in arguments.files})


def draw(calibrations: dict[str, Calibration]) -> Figure:
    """Phase above gain, by element of the array; elements on another's input have a ring."""
    drawn = new_figure(3.6)
    phase, gain = drawn.subplots(2, 1, sharex=True)
    swapped = False
    shifts = np.linspace(-APART, APART, len(calibrations)) if len(calibrations) > 1 else np.zeros(1)
    for (name, c), (colour, marker), shift in zip(calibrations.items(), _LOOKS, shifts, strict=False):
        moved = np.array(c.antenna_order) != np.arange(c.antennas)
        element = np.arange(c.antennas) + shift
        # Phases are known but for whole turns.
        degrees = np.degrees(np.angle(np.exp(1j * np.array(c.antenna_phase_rad))))
        for axes, values in ((phase, degrees), (gain, 20 * np.log10(c.antenna_gain))):
            axes.plot(element, values, marker, color=colour, markersize=3.2, label=name)
            axes.vlines(element, 0, values, color=colour, linewidth=0.7, alpha=0.5)
            axes.plot(element[moved], values[moved], "o", color=INK, markersize=7, fillstyle="none")
        swapped |= bool(moved.any())
    phase.set(ylabel="phase (°)", ylim=(-190, 190), yticks=range(-180, 181, 90))
    gain.set(ylabel="gain (dB)", xlabel="element of the array")
    gain.xaxis.set_major_locator(MaxNLocator(integer=True))
    low, high = gain.get_ylim()
    gain.set_ylim(min(low, -1.0), max(high, 1.0))
    if swapped:
        phase.plot([], [], "o", color=INK, markersize=7, fillstyle="none", label="on another's input")
    drawn.legend(*phase.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return drawn


def _calibration(path: Path) -> Calibration:
    if path.suffix.lower() == ".mcap":
        held = RecordingReader(path).array.calibration
        if held is None:
            raise SetupError(f"{path} holds no calibration")
        return held
    try:
        return load_calibration(path)
    except ValueError as error:
        raise SetupError(str(error)) from None
