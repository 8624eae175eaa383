"""Angle and range spectra of one UE, with the estimate, its standard deviation, and the truth."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from chachart.node.commands.figures.style import BLUE, INK, ORANGE, new_figure
from chachart.node.commands.shared.charting import estimate, estimator_for, settings_for
from chachart.node.data.errors import SetupError
from chachart.node.files.chart_log import is_chart_log
from chachart.node.files.recording import RecordingReader

FLOOR_DB = -60.0
"""No spectrum is drawn below."""


def figure(arguments: argparse.Namespace) -> Figure:
    """The spectra of UE `--ue` after all frames of the recording.

    Raises
    ------
    SetupError
        If the file is no recording, or the UE is not in it.
    """
    path = arguments.files[0]
    if is_chart_log(path):
        raise SetupError(f"{path} is a chart log and holds no spectra; they need a recording")
    if len(arguments.files) > 1:
        raise SetupError(f"one recording at a time, not {len(arguments.files)} files")
    reader = RecordingReader(path)
    estimator = estimator_for(reader, settings_for(arguments, reader), arguments.calibration)
    chart, _ = estimate(reader, estimator)
    spectrum = estimator.spectrum(arguments.ue)
    if spectrum is None:
        some = ", ".join(map(str, np.sort(chart.ue)[:5]))
        raise SetupError(f"{path} has no frames of UE {arguments.ue}; it has {len(chart)} UEs: {some} ...")
    truth = (np.nan, np.nan)
    row = chart.take(chart.ue == np.uint64(arguments.ue))
    if row.position is not None and len(row):
        true_theta, true_rho = reader.array.theta_rho(row.position)
        truth = float(true_theta[0]), float(true_rho[0])
    method = estimator.method
    return draw(spectrum, truth, f"UE {arguments.ue}, {path.name}, {method.theta}/{method.rho}")


def draw(spectrum: dict[str, Any], truth: tuple[float, float], title: str) -> Figure:
    """A panel for theta and, where the method has a range spectrum, one for rho.

    `spectrum` is that of `ChartEstimator.spectrum`, `truth` theta (rad) and rho (m), NaN where unknown.
    """
    panels = 2 if "rho_spectrum" in spectrum else 1
    drawn = new_figure(0.5 + 1.75 * panels, title)
    top = drawn.add_subplot(panels, 1, 1)
    values = np.degrees([spectrum["theta"], spectrum["theta_std"], truth[0]])
    _panel(top, np.degrees(spectrum["theta_grid_rad"]), spectrum["theta_spectrum"], values, "°")
    top.set(xlabel="θ from the array's axis (°)", xlim=(0, 180), xticks=range(0, 181, 30))
    if panels == 2:
        below = drawn.add_subplot(panels, 1, 2)
        values = np.array([spectrum["rho"], spectrum["rho_std"], truth[1]])
        _panel(below, spectrum["rho_grid_m"], spectrum["rho_spectrum"], values, " m")
        below.set(xlabel="ρ (m)", xlim=(0, float(spectrum["rho_grid_m"][-1])))
    return drawn


def _panel(axes: Axes, grid: NDArray[Any], power: NDArray[Any], values: NDArray[Any], unit: str) -> None:
    """One spectrum in dB; `values` are estimate, standard deviation and truth in the unit of the grid."""
    peak, std, true = values
    spectrum_db = 10 * np.log10(np.maximum(power, 10 ** (FLOOR_DB / 10)))
    axes.plot(grid, spectrum_db, color=BLUE)
    label = f"estimate {peak:.2f}{unit}"
    if np.isfinite(std):
        axes.axvspan(peak - std, peak + std, color=ORANGE, alpha=0.25, linewidth=0)
        label = f"estimate {peak:.2f} ± {std:.2g}{unit}"
    axes.axvline(peak, color=ORANGE, linewidth=1, label=label)
    if np.isfinite(true):
        axes.axvline(true, color=INK, linewidth=1, linestyle=(0, (2, 2)), label=f"truth {true:.2f}{unit}")
    axes.set(ylabel="spectrum (dB)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, borderaxespad=0.1)
