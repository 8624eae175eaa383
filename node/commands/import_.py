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
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from chachart.config.describe import allowed
from chachart.config.settings import ArraySettings
from chachart.node.commands.cli import progress
from chachart.node.csi import CsiBlock
from chachart.node.errors import SetupError
from chachart.node.geometry import ArrayGeometry
from chachart.node.recording import RecordingWriter
from chachart.sources.formats import open_capture
from chachart.sources.formats.arrange import (
    AXES,
    column,
    defects,
    frames,
    identities,
    occurrence,
    positions,
    times_ns,
)
from chachart.sources.formats.base import Capture

BLOCK_FRAMES = 64

_ARRAY_OPTIONS = {
    "name": "--array-name",
    "carrier_hz": "--carrier-hz",
    "subcarrier_spacing_hz": "--subcarrier-spacing-hz",
    "position_m": "--array-position",
    "axis": "--array-axis",
    "broadside": "--array-broadside",
    "element_spacing_m": "--element-spacing-m",
    "height_m": "--height-m",
    "light_speed_m_s": "--light-speed-m-s",
    "antennas": "--axes (antenna)",
    "subcarriers": "--axes (subcarrier)",
}

Converted = TypeVar("Converted")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart import`."""
    parser.add_argument("capture", type=Path, metavar="IN", help="the capture: .npz or MATLAB v5 .mat")
    parser.add_argument("recording", type=Path, metavar="OUT.mcap", help="the recording to write")
    parser.add_argument("--force", action="store_true", help="replace OUT.mcap if it exists")
    data = parser.add_argument_group("what the file holds")
    data.add_argument("--csi", required=True, metavar="NAME", help="the variable with the CSI")
    data.add_argument(
        "--axes",
        default="ue,antenna,subcarrier",
        help=f"its axes in their order, of {', '.join(AXES)}; a missing one means one (%(default)s)",
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
    if not arguments.recording.parent.is_dir():
        raise SetupError(f"{arguments.recording} cannot be written: there is no such folder")
    if arguments.recording.exists() and not arguments.force:
        raise SetupError(f"{arguments.recording} exists already; --force replaces it")
    if not (math.isfinite(arguments.rate) and arguments.rate > 0):
        raise SetupError(f"--rate {arguments.rate:g}: must be a number > 0")
    if arguments.snr_db is not None and not math.isfinite(arguments.snr_db):
        raise SetupError(f"--snr-db {arguments.snr_db:g}: must be a number")
    if arguments.time and arguments.repeat > 1:
        raise SetupError("--time and --repeat exclude each other: repeated frames have no time of their own")
    capture = open_capture(arguments.capture)
    csi = _converted(capture, "--csi", arguments.csi, lambda v: frames(v, arguments.axes.split(",")))
    array = _geometry(arguments, csi.shape)
    table = _table(arguments, capture, csi, array)
    note = {
        "imported_from": arguments.capture.name,
        "format": capture.format,
        "repeat": arguments.repeat,
        "snr_db": arguments.snr_db,
        "seed": arguments.seed,
    }
    total = len(table.ue) * arguments.repeat
    with (
        _written_whole(arguments.recording) as part,
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


@dataclass(frozen=True, slots=True)
class _Table:
    """The frames of a capture: csi (K, N_R, N_S), who, when (None: by rate) and where (None: unknown)."""

    csi: NDArray[np.complex64]
    ue: NDArray[np.uint64]
    time_ns: NDArray[np.int64] | None
    position: NDArray[np.float32] | None
    noise_std: float
    remark: str

    def blocks(self, array: str, repeat: int, rate_hz: float, seed: int) -> Iterator[CsiBlock]:
        """All frames once, then all again, `repeat` times, with fresh noise each time."""
        rng = np.random.default_rng(seed)
        total = len(self.ue) * repeat
        for start in range(0, total, BLOCK_FRAMES):
            n = np.arange(start, min(start + BLOCK_FRAMES, total))
            row = n % len(self.ue)
            csi = self.csi[row]
            if self.noise_std:
                noise = rng.standard_normal((*csi.shape, 2), np.float32) * np.float32(self.noise_std)
                csi = csi + noise.view(np.complex64)[..., 0]
            times = (n / rate_hz * 1e9).astype(np.int64) if self.time_ns is None else self.time_ns[row]
            position = None if self.position is None else self.position[row]
            yield CsiBlock(array, start, self.ue[row], times, csi, position)


def _table(
    arguments: argparse.Namespace, capture: Capture, csi: NDArray[np.complex64], array: ArrayGeometry
) -> _Table:
    count = len(csi)
    ue = np.arange(count, dtype=np.uint64)
    if arguments.ue:
        ue = _converted(capture, "--ue", arguments.ue, lambda v: identities(column(v, count)))
    time_ns = position = None
    if arguments.time:
        time_ns = _converted(capture, "--time", arguments.time, lambda v: times_ns(column(v, count)))
    if arguments.position:
        plane = array.position_m[2] - (array.height_m or array.position_m[2])
        position = _converted(capture, "--position", arguments.position, lambda v: positions(v, count, plane))
    found = defects(csi)
    bad = np.flatnonzero(found != "")
    if len(bad) and not arguments.skip_bad:
        others = f", as are {len(bad) - 1} others" if len(bad) > 1 else ""
        raise SetupError(
            f'{capture.path}: frame {bad[0]} of "{arguments.csi}" {found[bad[0]]}{others} '
            f"(--skip-bad leaves such frames out); the file has {capture.listing()}"
        )
    if len(bad) == count:
        raise SetupError(f'{capture.path}: every frame of "{arguments.csi}" is zero, constant or not finite')
    # By time where it is known, else every UE's first frame, every UE's second, ...
    order = np.argsort(occurrence(ue) if time_ns is None else time_ns, kind="stable")
    good = order[found[order] == ""]
    csi = csi[good]
    noise_std = 0.0
    if arguments.snr_db is not None:
        power = float(np.mean(np.square(np.abs(csi), dtype=np.float64)))
        csi = csi / np.float32(math.sqrt(power))
        noise_std = math.sqrt(0.5 * 10 ** (-arguments.snr_db / 10))
    return _Table(
        csi,
        ue[good],
        None if time_ns is None else time_ns[good],
        None if position is None else position[good],
        noise_std,
        f", {len(bad)} bad frames left out" if len(bad) else "",
    )


def _geometry(arguments: argparse.Namespace, shape: tuple[int, ...]) -> ArrayGeometry:
    values = {
        "name": arguments.array_name,
        "antennas": shape[1],
        "subcarriers": shape[2],
        "carrier_hz": arguments.carrier_hz,
        "subcarrier_spacing_hz": arguments.subcarrier_spacing_hz,
        "position_m": arguments.array_position,
        "axis": arguments.array_axis,
        "broadside": arguments.array_broadside,
        "element_spacing_m": arguments.element_spacing_m,
        "height_m": arguments.height_m,
        "light_speed_m_s": arguments.light_speed_m_s,
    }
    if shape[2] > 1 and arguments.subcarrier_spacing_hz is None:
        raise SetupError(f"--subcarrier-spacing-hz is needed: the file has {shape[2]} subcarriers")
    given = {name: value for name, value in values.items() if value is not None}
    try:
        return ArraySettings(**given).geometry()
    except ValidationError as error:
        lines = []
        for name in dict.fromkeys(str(detail["loc"][0]) for detail in error.errors()):
            rule = allowed(ArraySettings.model_fields[name])
            lines.append(f"{_ARRAY_OPTIONS[name]} {values[name]}: must be {rule}")
        raise SetupError("\n".join(lines)) from None
    except ValueError as error:
        raise SetupError(f"--array-axis, --array-broadside: {error}") from None


def _converted(
    capture: Capture, option: str, name: str, convert: Callable[[NDArray[Any]], Converted]
) -> Converted:
    try:
        return convert(capture.read(name))
    except ValueError as error:
        raise SetupError(f"{option} {name}: {error}; {capture.path} has {capture.listing()}") from None


@contextmanager
def _written_whole(path: Path) -> Iterator[Path]:
    """A name to write to beside `path`; it takes that name when all went well, and goes away otherwise."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error.strerror}") from None
    finally:
        part.unlink(missing_ok=True)


def _vector(text: str) -> tuple[float, ...]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} must be three numbers, as in 0,0,10") from None
    return x, y, z


def _direction(text: str) -> str | tuple[float, ...]:
    return _vector(text) if "," in text else text


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} must be a whole number >= 1")
    return int(text)


def _seed(text: str) -> int:
    return 0 if text == "0" else _count(text)
