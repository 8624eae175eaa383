"""Draw figures for papers and notes: PNG, SVG or PDF, as wide as a column.

    chachart plot chart capture.mcap --theta music -o chart.pdf    or a chart log: what the node had charted
    chachart plot spectra capture.mcap --ue 7 -o ue7.png
    chachart plot quality chart.mcap -o quality.png                or a recording, or quality.jsonl
    chachart plot errors capture.mcap -o errors.svg
    chachart plot calibration cal.toml -o cal.png

A recording is charted first, as chachart evaluate does it; of a chart log the newest place of each UE counts,
and files that it was continued in may follow. What a file is, its content says.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path

from chachart.node.commands.shared.charting import add_options
from chachart.node.commands.shared.cli import FIGURE_FORMATS, check_figure
from chachart.node.data.extras import require

FIGURES = {
    "chart": "true positions and chart side by side, coloured by true position",
    "spectra": "angle and range spectra of a UE, with estimate, standard deviation and truth",
    "quality": "trustworthiness and continuity against the neighbours, and over time",
    "errors": "a map of the position errors",
    "calibration": "phase and gain of each antenna, of one or several calibrations",
}
"""Each figure and what it shows; its module in `figures` has `figure(arguments)`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart plot`."""
    figures = parser.add_subparsers(metavar="FIGURE", required=True, dest="figure")
    for name, purpose in FIGURES.items():
        subparser = figures.add_parser(name, help=purpose, description=purpose)
        subparser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="what to draw")
        subparser.add_argument(
            "-o",
            "--output",
            type=Path,
            required=True,
            metavar="OUT",
            help=f"the figure: {', '.join(FIGURE_FORMATS)}",
        )
        if name == "spectra":
            subparser.add_argument("--ue", type=int, required=True, help="which UE")
        if name != "calibration":
            add_options(subparser)


def run(arguments: argparse.Namespace) -> int:
    """Draw the figure.

    Raises
    ------
    SetupError
        If a file does not hold what the figure needs, or the figure cannot be written.
    """
    check_figure(arguments.output)
    require("plot", "chachart plot:")
    module = import_module(f"chachart.node.commands.figures.{arguments.figure}")
    style = import_module("chachart.node.commands.figures.style")
    style.write(arguments.output, lambda: module.figure(arguments))
    print(arguments.output)
    return 0
