"""The command line of `chachart import`."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import get_args

from chachart.node.data.facts import Delay, Phase
from chachart.sources.formats.arrange import AXES, TIME_UNITS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart import`."""
    parser.add_argument("captures", type=Path, nargs="+", metavar="IN", help="the captures, one or several")
    parser.add_argument("recording", type=Path, metavar="OUT.mcap", help="the recording to write")
    parser.add_argument("--force", action="store_true", help="replace OUT.mcap if it exists")
    parser.add_argument("--zstd", action="store_true", help="compress OUT.mcap")
    parser.add_argument("--strict", action="store_true", help="refuse files of which anything is left out")
    _add_data(parser.add_argument_group("what the files hold"))
    _add_wifi(parser.add_argument_group("Wi-Fi captures: which frames (the commonest), and what power means"))
    _add_array(parser.add_argument_group("the array that measured it"))
    out = parser.add_argument_group("what to make of it")
    out.add_argument("--repeat", type=_count, default=1, metavar="N", help="write each frame N times (1)")
    out.add_argument("--snr-db", type=float, metavar="X", help="scale to mean |csi|^2 = 1 and add noise")
    out.add_argument("--seed", type=_seed, default=0, help="of the noise (%(default)s)")
    out.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="frames/s in all (%(default)g)")


def _add_data(data: argparse._ArgumentGroup) -> None:
    data.add_argument(
        "--csi",
        metavar="NAME",
        help="the variable with the CSI, or REAL,IMAGINARY (Wi-Fi: csi, the first stream; all: every stream)",
    )
    data.add_argument(
        "--axes",
        help=f"its axes in order, of {', '.join(AXES)}; a missing one means one (ue,antenna,subcarrier)",
    )
    data.add_argument(
        "--take",
        type=_cut,
        action="append",
        default=[],
        metavar="AXIS=N",
        help="cut another axis at N, as rx=0",
    )
    data.add_argument("--shape", type=_shape, metavar="N,N,...", help="its shape, where the file has it flat")
    data.add_argument("--conjugate", action="store_true", help="the file has the conjugate (delay e^{+j...})")
    data.add_argument("--fftshift", action="store_true", help="its subcarriers are in the order of the FFT")
    data.add_argument(
        "--frames", type=_slice, default=slice(None), metavar="FROM:TO:STEP", help="which frames, from 0 on"
    )
    data.add_argument(
        "--subcarriers", type=_slice, default=slice(None), metavar="FROM:TO:STEP", help="which subcarriers"
    )
    data.add_argument(
        "--position",
        type=_position,
        action="append",
        default=[],
        metavar="NAME or X,Y,Z",
        help="known positions in metres: a variable (ues, 3), NaN unknown; or a place, once for each file",
    )
    data.add_argument(
        "--position-unit",
        choices=("m", "deg"),
        default="m",
        help="deg: latitude, longitude and perhaps height of --position and --position-from (%(default)s)",
    )
    data.add_argument(
        "--origin", type=_origin, metavar="LAT,LON", help="where x = y = 0 is, x to the east, y to the north"
    )
    data.add_argument(
        "--position-from", type=Path, metavar="TABLE.csv", help="the place of each file: file,x,y[,z]"
    )
    data.add_argument(
        "--ue",
        metavar="NAME or N",
        help="who sent each frame, or a number for all; else n of frame n, or the sender",
    )
    data.add_argument(
        "--ue-mac",
        type=_mac,
        metavar="MAC",
        help="keep its frames; the sender of all, if none is told",
    )
    data.add_argument("--time", metavar="NAME", help="when: whole numbers are ns since 1970, others s")
    data.add_argument("--time-unit", choices=TIME_UNITS, help="the unit of --time")
    data.add_argument("--skip-bad", action="store_true", help=argparse.SUPPRESS)
    data.add_argument("--phase", choices=get_args(Phase), help="whether frames share a phase (Wi-Fi: random)")
    data.add_argument("--delay", choices=get_args(Delay), help="whether there is a clock (Wi-Fi: relative)")


def _add_wifi(wifi: argparse._ArgumentGroup) -> None:
    wifi.add_argument("--antennas", metavar="N or AC", help="with so many antennas, or on these connectors")
    wifi.add_argument("--streams", type=_count, metavar="N", help="with so many streams")
    wifi.add_argument(
        "--tones",
        type=_tones,
        default="used",
        metavar="N or LIST",
        help="so many subcarriers, or all (guards too); arrays: their numbers, as -28:-1,1:28",
    )
    wifi.add_argument("--bandwidth", type=float, metavar="MHZ", help="so wide")
    wifi.add_argument("--kind", type=_count, metavar="N", help="the N-th commonest kind of frames")
    wifi.add_argument(
        "--power",
        choices=("auto", "rssi", "agc", "raw"),
        default="auto",
        help="scale frames to their RSSI, undo the AGC, or leave them (rssi where every frame has it)",
    )


def _add_array(array: argparse._ArgumentGroup) -> None:
    array.add_argument("--carrier-hz", type=float, metavar="HZ", help="of subcarrier 0 (Wi-Fi: the middle)")
    array.add_argument("--subcarrier-spacing-hz", type=float, metavar="HZ")
    array.add_argument(
        "--override", action="store_true", help="believe these two options where the file says otherwise"
    )
    array.add_argument("--array-name", default="lab", metavar="NAME", help="goes into topics (%(default)s)")
    array.add_argument("--array-position", type=_vector, metavar="X,Y,Z", help="of element 0 (0,0,10)")
    array.add_argument("--array-axis", type=_direction, metavar="AXIS", help="x, y, -y ... or X,Y,Z (y)")
    array.add_argument("--array-broadside", type=_direction, metavar="AXIS", help="the side of the UEs")
    array.add_argument("--element-spacing-m", type=float, metavar="M", help="(half a wavelength)")
    array.add_argument("--height-m", type=float, metavar="M", help="above the UEs; projects slant ranges")
    array.add_argument("--light-speed-m-s", type=float, metavar="M_S")


def _vector(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} must be three numbers, as in 0,0,10") from None
    return x, y, z


def _position(text: str) -> str | tuple[float, float, float]:
    return _vector(text) if re.fullmatch(r"[-+0-9.eE]+(,[-+0-9.eE]+)+", text) else text


def _origin(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = (float(part) for part in text.split(","))
        if abs(latitude) > 90 or abs(longitude) > 180:
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} must be latitude and longitude in degrees") from None
    return latitude, longitude


def _direction(text: str) -> str | tuple[float, ...]:
    return _vector(text) if "," in text else text


def _shape(text: str) -> tuple[int, ...]:
    return tuple(_count(part) for part in text.split(","))


def _tones(text: str) -> str:
    if text not in ("used", "all") and not re.fullmatch(r"[-0-9,:]+", text):
        raise argparse.ArgumentTypeError(f"{text} must be all, a number, or numbers as in -28:-1,1:28")
    return text


def _cut(text: str) -> tuple[str, int]:
    name, sign, index = text.partition("=")
    if not sign or not name or not index.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} must look like rx=0")
    return name, int(index)


def _mac(text: str) -> int:
    if not re.fullmatch(r"([0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}", text):
        raise argparse.ArgumentTypeError(f"{text} must look like 02:00:00:00:00:01")
    return int(re.sub("[:-]", "", text), 16)


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
