"""Turn a capture of another tool into a recording that a node replays.

    chachart import capture.npz capture.mcap --csi H --axes ue,antenna,subcarrier --position xyz \\
        --carrier-hz 2e9 --subcarrier-spacing-hz 312500 --array-position 0,0,10 --array-axis y

The format is found by what the file holds, not by its name. Frames are written in the order of --time; where
there is none, every UE gets its n-th frame before any gets its next. A value that begins with a minus sign is
written with an equals sign, as in --array-axis=-y.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from chachart.node.commands.shared.cli import check_writable, progress, written_whole
from chachart.node.commands.shared.importing import read_table
from chachart.node.data.errors import SetupError
from chachart.node.files.recording import RecordingWriter
from chachart.sources.formats import open_capture
from chachart.sources.formats.arrange import AXES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart import`."""
    parser.add_argument("capture", type=Path, metavar="IN", help="the capture")
    parser.add_argument("recording", type=Path, metavar="OUT.mcap", help="the recording to write")
    parser.add_argument("--force", action="store_true", help="replace OUT.mcap if it exists")
    data = parser.add_argument_group("what the file holds")
    data.add_argument("--csi", required=True, metavar="NAME", help="the variable with the CSI")
    data.add_argument(
        "--axes",
        help=f"its axes in order, of {', '.join(AXES)}; a missing one means one (ue,antenna,subcarrier)",
    )
    data.add_argument("--shape", type=_shape, metavar="N,N,...", help="its shape, where the file has it flat")
    data.add_argument(
        "--frames",
        type=_slice,
        default=slice(None),
        metavar="FROM:TO:STEP",
        help="which frames of it, from 0 on",
    )
    data.add_argument(
        "--subcarriers",
        type=_slice,
        default=slice(None),
        metavar="FROM:TO:STEP",
        help="which subcarriers of it",
    )
    data.add_argument("--position", metavar="NAME", help="known positions in metres, (ues, 3), NaN unknown")
    data.add_argument("--ue", metavar="NAME", help="who sent each frame; else frame n is of UE n")
    data.add_argument("--time", metavar="NAME", help="when: whole numbers are ns since 1970, others s")
    data.add_argument("--skip-bad", action="store_true", help="leave out zero, constant, non-finite frames")
    array = parser.add_argument_group("the array that measured it")
    array.add_argument("--carrier-hz", type=float, required=True, metavar="HZ", help="of subcarrier 0")
    array.add_argument("--subcarrier-spacing-hz", type=float, metavar="HZ")
    array.add_argument("--array-name", default="lab", metavar="NAME", help="goes into topics (%(default)s)")
    array.add_argument("--array-position", type=_vector, metavar="X,Y,Z", help="of element 0 (0,0,10)")
    array.add_argument("--array-axis", type=_direction, metavar="AXIS", help="x, y, -y ... or X,Y,Z (y)")
    array.add_argument("--array-broadside", type=_direction, metavar="AXIS", help="the side of the UEs")
    array.add_argument("--element-spacing-m", type=float, metavar="M", help="(half a wavelength)")
    array.add_argument("--height-m", type=float, metavar="M", help="above the UEs; projects slant ranges")
    array.add_argument("--light-speed-m-s", type=float, metavar="M_S")
    out = parser.add_argument_group("what to make of it")
    out.add_argument("--repeat", type=_count, default=1, metavar="N", help="write each frame N times (1)")
    out.add_argument("--snr-db", type=float, metavar="X", help="scale to mean |csi|^2 = 1 and add noise")
    out.add_argument("--seed", type=_seed, default=0, help="of the noise (%(default)s)")
    out.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="frames/s in all (%(default)g)")


def run(arguments: argparse.Namespace) -> int:
    """Import the capture.

    Raises
    ------
    SetupError
        If the capture, a variable or an option does not fit.
    """
    check_writable(arguments.recording, arguments.force, arguments.capture)
    if not (math.isfinite(arguments.rate) and arguments.rate > 0):
        raise SetupError(f"--rate {arguments.rate:g}: must be a number > 0")
    if arguments.snr_db is not None and not math.isfinite(arguments.snr_db):
        raise SetupError(f"--snr-db {arguments.snr_db:g}: must be a number")
    if arguments.time and arguments.repeat > 1:
        raise SetupError("--time and --repeat exclude each other: repeated frames have no time of their own")
    capture = open_capture(arguments.capture)
    array, table = read_table(arguments, capture)
    note = {
        "imported_from": arguments.capture.name,
        "format": capture.format,
        "repeat": arguments.repeat,
        "snr_db": arguments.snr_db,
        "seed": arguments.seed,
    }
    total = len(table.ue) * arguments.repeat
    with (
        written_whole(arguments.recording) as part,
        RecordingWriter(part, array, note=note) as writer,
        progress("importing", total) as advance,
    ):
        for block in table.blocks(array.name, arguments.repeat, arguments.rate, arguments.seed):
            writer.write(block)
            advance(len(block))
    ues = len(np.unique(table.ue))
    megabytes = arguments.recording.stat().st_size / 1e6
    print(
        f"{arguments.recording}: {total} frames of {ues} UEs, {array.antennas} antennas x "
        f"{array.subcarriers} subcarriers, {megabytes:.1f} MB, from {capture.format}{table.remark}"
    )
    return 0


def _vector(text: str) -> tuple[float, ...]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} must be three numbers, as in 0,0,10") from None
    return x, y, z


def _direction(text: str) -> str | tuple[float, ...]:
    return _vector(text) if "," in text else text


def _shape(text: str) -> tuple[int, ...]:
    return tuple(_count(part) for part in text.split(","))


def _slice(text: str) -> slice:
    parts = text.split(":")
    if (
        not 1 < len(parts) < 4
        or not all(part.isdecimal() or not part for part in parts)
        or parts[2:] == ["0"]
    ):
        raise argparse.ArgumentTypeError(f"{text} must look like 0:1000 or 0:1000:10")
    return slice(*(int(part) if part else None for part in parts))


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} must be a whole number >= 1")
    return int(text)


def _seed(text: str) -> int:
    return 0 if text == "0" else _count(text)
