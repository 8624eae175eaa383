"""The report's figures, each for a light and a dark page."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from PIL import Image

from chachart.node.commands.figures.chart import position_colours
from chachart.node.commands.figures.style import share, share_axis
from chachart.node.commands.reproduction.accuracy import Accuracy
from chachart.node.commands.reproduction.embeddings import aligned
from chachart.node.commands.reproduction.paper import Pair, published
from chachart.node.commands.reproduction.runs import Charted, display
from chachart.sources.scenario.layout import LETTER_UES

Floats = NDArray[np.float64]

DPI = 130
COLOURS = 96
MOST_COLUMNS = 5


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of a page. `methods` gives lines theirs, by the method of rho."""

    name: str
    ink: str
    soft: str
    paper: str
    methods: dict[str, str]


LIGHT = Theme(
    "light",
    ink="#1b1f24",
    soft="#8a929b",
    paper="#ffffff",
    methods={
        "bartlett": "#0072b2",
        "music": "#d55e00",
        "lr": "#009e73",
        "isq": "#b0569b",
        "mvdr": "#009e73",
        "minnorm": "#b0569b",
        "joint": "#111111",
    },
)
DARK = Theme(
    "dark",
    ink="#e4e7eb",
    soft="#7d8590",
    paper="#14171b",
    methods={
        "bartlett": "#56b4e9",
        "music": "#ff9d4d",
        "lr": "#2fd3a5",
        "isq": "#e29ad0",
        "mvdr": "#2fd3a5",
        "minnorm": "#e29ad0",
        "joint": "#ffffff",
    },
)
THEMES = (LIGHT, DARK)
_STYLES = {"bartlett": "-", "music": "--", "mvdr": ":", "minnorm": "-.", "joint": "-"}
_CHANNELS = {"los": "LOS", "qlos": "QLOS", "qnlos": "QNLOS"}

Drawing = Callable[[Theme], Figure]


def png(drawing: Drawing, theme: Theme) -> bytes:
    """The drawing in a theme, as a PNG file."""
    with mpl.rc_context(_style(theme)):
        figure = drawing(theme)
        FigureCanvasAgg(figure)
        drawn, file = io.BytesIO(), io.BytesIO()
        figure.savefig(drawn, format="png", dpi=DPI)
    # A palette takes a fifth of the bytes, and the page holds every figure twice.
    image = Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    image.save(file, format="png", optimize=True)
    return file.getvalue()


def charts(truth: Floats, charted: Sequence[Charted], embeddings: Sequence[Charted]) -> Drawing:
    """The true positions and every chart, UEs coloured by their true position, the letters in ink."""
    panels = [("true positions", truth)]
    panels += [(_judged(c), c.xy) for c in charted]
    panels += [(_judged(c), aligned(c.xy, truth)) for c in embeddings]
    everyone = np.ones(len(truth), bool)
    colours = position_colours(truth[:, 0], truth[:, 1], everyone)
    letters = np.arange(len(truth)) < LETTER_UES
    rows = -(-len(panels) // MOST_COLUMNS)
    columns = -(-len(panels) // rows)
    size = float(np.clip(5000 / len(truth), 1.5, 12))

    def draw(theme: Theme) -> Figure:
        figure = Figure(figsize=(2.0 * columns + 0.5, 2.95 * rows + 0.3), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for ax, (title, xy) in zip(axes, panels, strict=False):
            ax.scatter(*xy[~letters].T, s=size, c=colours[~letters], linewidths=0, rasterized=True)
            ax.scatter(*xy[letters].T, s=1.3 * size, color=theme.ink, linewidths=0, rasterized=True)
            ax.plot(0, 0, marker=">", color=theme.ink, markersize=6, clip_on=False)
            ax.set_title(title, fontsize=8)
            ax.set(xlim=(-20, 760), ylim=(-620, 620), aspect="equal")
            ax.set(xticks=(0, 300, 600), yticks=(-500, 0, 500))
        for ax in axes[len(panels) :]:
            ax.set_visible(False)
        figure.supxlabel("x along broadside (m)", fontsize=9)
        figure.supylabel("y along the array (m)", fontsize=9)
        return figure

    return draw


def pdf(drawing: Drawing) -> bytes:
    """The drawing for print, as a PDF file whose text stays text."""
    file = io.BytesIO()
    with mpl.rc_context({**_style(THEMES[0]), "pdf.fonttype": 42}):
        figure = drawing(THEMES[0])
        FigureCanvasAgg(figure)
        figure.savefig(file, format="pdf", metadata={"CreationDate": None})
    return file.getvalue()


def _style(theme: Theme) -> dict[Any, Any]:
    return {
        "font.size": 9,
        "axes.titlesize": 9,
        "axes.facecolor": theme.paper,
        "figure.facecolor": theme.paper,
        "legend.frameon": False,
        "grid.color": theme.soft,
        "grid.alpha": 0.25,
        "axes.spines.top": False,
        "axes.spines.right": False,
        **{f"axes.{name}": theme.ink for name in ("labelcolor", "titlecolor")},
        **dict.fromkeys(("text.color", "xtick.labelcolor", "ytick.labelcolor"), theme.ink),
        **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), theme.soft),
    }


def curves(pairs: Sequence[Pair], charted: Sequence[Charted], others: Sequence[Charted]) -> Drawing:
    """TW and CT of every pair, and of the embeddings, for all numbers of neighbours."""

    def draw(theme: Theme) -> Figure:
        figure = Figure(figsize=(9.0, 3.8), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        lines = [
            (c, theme.methods[pair[1]], _STYLES[pair[0]]) for pair, c in zip(pairs, charted, strict=True)
        ]
        lines += [(c, theme.soft, style) for c, style in zip(others, ("-", "--"), strict=False)]
        widths = np.linspace(3.6, 1.0, len(lines))  # where lines coincide, each shows
        for ax, name in ((left, "TW"), (right, "CT")):
            for (c, colour, style), width in zip(lines, widths, strict=True):
                values = c.tw if name == "TW" else c.ct
                k = np.arange(1, len(values) + 1)
                ax.plot(k, share(values), style, color=colour, linewidth=width, label=c.name)
            share_axis(ax, "y")
            ax.set(xlabel="neighbours K", title=name)
        figure.legend(*left.get_legend_handles_labels(), loc="outside right upper", fontsize=8)
        return figure

    return draw


def summary(pairs: Sequence[Pair], channels: dict[str, Sequence[Charted]]) -> Drawing:
    """TW and CT of every pair on every channel, hollow as published and filled as measured here."""

    def draw(theme: Theme) -> Figure:
        figure = Figure(figsize=(9.0, 0.8 + 0.32 * len(pairs)), layout="constrained")
        panels = figure.subplots(1, len(channels), sharey=True, squeeze=False)[0]
        kinds = (("tw", "o", -0.14, theme.methods["bartlett"]), ("ct", "s", 0.14, theme.methods["music"]))
        for ax, (channel, charted) in zip(panels, channels.items(), strict=True):
            for row, (pair, c) in enumerate(zip(pairs, charted, strict=True)):
                before = published(channel, pair)
                for kind, marker, shift, colour in kinds:
                    here = share(getattr(c, kind)[-1:])[0]
                    if before is not None:
                        there = share(np.array([getattr(before, kind)]))[0]
                        ax.plot([there, here], [row + shift] * 2, color=colour, linewidth=1, alpha=0.6)
                        ax.plot(there, row + shift, marker, color=colour, fillstyle="none", markersize=4.5)
                    ax.plot(here, row + shift, marker, color=colour, markersize=4.5)
            share_axis(ax, "x")
            ax.set(title=_CHANNELS[channel], yticks=range(len(pairs)), ylim=(len(pairs) - 0.5, -0.5))
            ax.set_yticklabels([display(pair) for pair in pairs])
        handles = [
            Line2D([], [], linestyle="", marker=marker, color=colour, mfc=fill or colour, label=label)
            for kind, marker, _, colour in kinds
            for fill, label in (("none", f"{kind.upper()} published"), ("", f"{kind.upper()} here"))
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8)
        return figure

    return draw


def accuracy(measured: Sequence[Accuracy]) -> Drawing:
    """Root mean squared errors against the SNR, with the bounds."""

    def draw(theme: Theme) -> Figure:
        figure = Figure(figsize=(3.3 * len(measured), 3.6), layout="constrained")
        panels = figure.subplots(1, len(measured), squeeze=False)[0]
        markers = {"bartlett": "o", "mvdr": "v", "minnorm": "^", "music": "s", "joint": "D"}
        for ax, a in zip(panels, measured, strict=True):
            for method, rmse in a.rmse.items():
                ax.plot(
                    a.snrs_db,
                    rmse,
                    marker=markers[method],
                    markersize=3.2,
                    linewidth=1,
                    color=theme.methods[method],
                    label=display((method,) * 2).split(" / ")[0],
                )
            for bound, style, label in (
                (a.stochastic, "-", "bound, unknown source"),
                (a.deterministic, "--", "bound, constant source"),
            ):
                ax.plot(a.snrs_db, bound, style, color=theme.soft, linewidth=1.6, zorder=0, label=label)
            ax.set(yscale="log", xlabel="SNR per antenna and subcarrier (dB)")
            symbol = {"theta": "θ", "rho": "ρ"}[a.coordinate]
            ax.set_title(f"RMSE of {symbol} ({a.unit}), {_bandwidth(a.bandwidth_hz)}")
            ax.grid(which="major")
        figure.legend(
            *panels[0].get_legend_handles_labels(),
            loc="outside lower center",
            ncols=len(markers) + 2 if len(measured) > 2 else 4,
            fontsize=8,
        )
        return figure

    return draw


def _bandwidth(hz: float) -> str:
    return f"{hz / 1e6:g} MHz" if hz >= 1e6 else f"{hz / 1e3:g} kHz"


def _judged(c: Charted) -> str:
    """Name, TW and CT."""
    return f"{c.name}  " + " ".join(f"{v[-1]:.4f}".removeprefix("0") for v in (c.tw, c.ct))
