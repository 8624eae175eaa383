"""Say and draw what an array looks like: elements with their numbers, pose, and what it can tell apart.

    chachart array lab.toml                         [array] of a configuration
    chachart array capture.mcap --plot array.png    of a recording, drawn
    chachart array spec.json --array 1              or of a file that array.file takes

What is drawn is seen from in front of the array, from where its UEs are.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np

from chachart.config.load import load
from chachart.config.settings import ArraySettings
from chachart.node.commands.shared.cli import check_writable
from chachart.node.data.elements import lattice, mirror, on_one_line, partners
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingReader


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart array`."""
    parser.add_argument("file", type=Path, metavar="FILE", help="configuration, recording, or array file")
    parser.add_argument("--array", type=int, metavar="N", help="which of the arrays in an array file, from 0")
    parser.add_argument("--element-spacing-m", type=float, metavar="M", help="where an array file lacks it")
    parser.add_argument("--carrier-hz", type=float, default=2e9, metavar="HZ", help="for an array file (2e9)")
    parser.add_argument("--plot", type=Path, metavar="OUT", help="draw it: .png, .svg or .pdf")
    parser.add_argument("--json", action="store_true", help="print it as recordings have it, as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Describe and draw the array.

    Raises
    ------
    SetupError
        If the file describes none, or the figure cannot be written.
    """
    array = _array(arguments)
    if arguments.json:
        print(json.dumps(array.as_dict(), indent=2))
    else:
        for name, value in lines(array):
            print(f"{name:<11} {value}")
    if arguments.plot is not None:
        if arguments.plot.suffix.lower() not in (".png", ".svg", ".pdf"):
            raise SetupError(f"{arguments.plot} must end in .png, .svg or .pdf")
        require("plot", "chachart array --plot:")
        check_writable(arguments.plot, force=True)
        figures = import_module("chachart.node.commands.figures.array")
        import_module("chachart.node.commands.figures.style").write(
            arguments.plot, lambda: figures.draw(array)
        )
    return 0


def lines(array: ArrayGeometry) -> Iterator[tuple[str, str]]:
    """What there is to say, as pairs of name and value."""
    own = array.own_elements
    yield "array", f"{array.name}: {array.antennas} elements, {shape(array)}"
    span = np.ptp(own, axis=0)
    yield "size", f"{span[0]:.4g} x {span[1]:.4g} x {span[2]:.4g} m (right x up x normal)"
    nearest = array.element_spacing_m
    yield "spacing", f"{nearest:.4g} m, {nearest / array.wavelength_m:.3g} wavelengths at the carrier"
    for name in ("right", "up", "normal"):
        yield name, "({:.4g}, {:.4g}, {:.4g})".format(*(getattr(array, name) + 0.0))
    yield "middle", "({:.4g}, {:.4g}, {:.4g}) m".format(*array.centre_m)
    yield "tells", tells(array)
    if array.height_m is not None:
        yield "UEs", f"in the plane {array.height_m:g} m below"
    yield "clock", "its own" if array.clock is None else f"{array.clock}, shared {array.clock_shares}"
    if array.elements is not None and partners(own) is None:
        yield "note", "no forward_backward: the elements are not symmetric about their middle"
    if nearest > 0.505 * array.wavelength_m and len(own) > 1:
        yield "note", "elements more than half a wavelength apart: some directions look alike"
    for number, place in enumerate(own if array.elements is not None else ()):
        yield f"element {number}", "right {:+.4f}  up {:+.4f}  normal {:+.4f} m".format(*place)


def shape(array: ArrayGeometry) -> str:
    """What the elements form, in words."""
    own = array.own_elements
    board = lattice(own)
    if array.is_line:
        return "a uniform line"
    if on_one_line(own):
        return "on one line"
    if board is not None:
        return f"a board of {board.rows} rows x {board.columns} columns"
    radius = np.linalg.norm(own, axis=1)
    plane = mirror(own)
    if plane is not None and len(own) > 2 and np.ptp(radius) < 1e-3 * radius.mean():
        return f"on a circle of {radius.mean():.4g} m"
    return "in space" if plane is None else "in a plane"


def tells(array: ArrayGeometry) -> str:
    """What directions the array can tell, and what it takes for granted."""
    if array.is_line or on_one_line(array.own_elements):
        return "theta alone, the angle to its axis; what is behind it is charted in front"
    plane, facing = mirror(array.own_elements), array.facing
    if plane is None:
        return "azimuth and elevation" + ("" if facing is None else f", of UEs {array.sees}")
    if facing is None:
        return "azimuth and elevation, but not the two sides of its plane"
    side = (
        "in front"
        if facing[2] > 0.5
        else "below"
        if facing[1] < -0.5
        else "above"
        if facing[1] > 0.5
        else "ahead"
    )
    return f"azimuth and elevation of UEs {side}; the mirror side of its plane looks the same to it"


def _array(arguments: argparse.Namespace) -> ArrayGeometry:
    path: Path = arguments.file
    if path.suffix.lower() == ".mcap":
        return RecordingReader(path).array
    if path.suffix.lower() == ".toml":
        settings = load(path).array
        if settings is None:
            raise SetupError(f"{path} has no [array]")
        return settings.geometry()
    try:
        return ArraySettings(
            file=path,
            file_array=arguments.array,
            carrier_hz=arguments.carrier_hz,
            element_spacing_m=arguments.element_spacing_m,
        ).geometry()
    except ValueError as error:
        raise SetupError(str(error)) from None
