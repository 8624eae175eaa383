"""Turn captures of other tools into a recording that a node replays.

    chachart import capture.npz capture.mcap --csi H --axes ue,antenna,subcarrier --position xyz \\
        --carrier-hz 2e9 --subcarrier-spacing-hz 312500 --array-position 0,0,10 --array-axis y
    chachart import street.npz street.mcap --snr-db 10
    chachart import POS1.dat POS2.dat lab.mcap --carrier-hz 5.32e9 --position 1,0,0 --position 2,0.5,0

The format is found by what a file holds, not by its name; gzip and bzip2 are unpacked. Frames that are whole
are kept, all others are counted by reason. Wi-Fi captures say most things themselves. Frames of arrays are
written in the order of --time; where there is none, every UE gets its n-th frame before any gets its next. A
value that begins with a minus sign is written with an equals sign, as in --array-axis=-y.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from chachart.node.commands.importing import arrays, places, report, several, wifi
from chachart.node.commands.importing.geometry import geometry
from chachart.node.commands.importing.options import add_arguments
from chachart.node.commands.importing.table import Band, Part, drop_bad, refuse_losses, table_of
from chachart.node.commands.shared.cli import check_writable, progress, written_whole
from chachart.node.data.errors import SetupError
from chachart.node.data.facts import CaptureFacts
from chachart.node.files.recording import RecordingWriter
from chachart.sources.formats import open_capture
from chachart.sources.formats.base import Capture
from chachart.sources.formats.raytraced import is_raytraced
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.log import mac

__all__ = ["add_arguments", "run"]


def run(arguments: argparse.Namespace) -> int:
    """Import the captures.

    Raises
    ------
    SetupError
        If a capture, a variable or an option does not fit.
    """
    for path in arguments.captures:
        check_writable(arguments.recording, arguments.force, path)
    _check(arguments)
    captures = [open_capture(path) for path in arguments.captures]
    if len(captures) == 1 and is_raytraced(captures[0]) and arguments.csi is None:
        return several.run(captures[0], arguments)
    is_wifi = [isinstance(capture, WifiCapture) for capture in captures]
    if any(is_wifi) != all(is_wifi):
        raise SetupError("Wi-Fi captures and files of arrays do not go into one recording")
    read = _wifi if any(is_wifi) else _arrays
    parts, band, facts = read(captures, arguments)
    for part in parts:
        drop_bad(part, arguments.csi or "csi", arguments.strict)
    if arguments.strict:
        refuse_losses(parts)
    array, remarks = geometry(parts, band, arguments)
    table = table_of(parts, arguments)
    total = len(table.ue) * arguments.repeat
    options = {"repeat": arguments.repeat, "snr_db": arguments.snr_db, "seed": arguments.seed}
    if len(parts) > 1 and arguments.repeat == 1 and parts[0].keep_order:
        options["starts"] = np.cumsum([0, *(len(part.ue) for part in parts[:-1])]).tolist()
    if band.antenna_names:
        options["antenna_names"] = list(band.antenna_names)
    note = report.note(parts, captures[0].format, options)
    with (
        written_whole(arguments.recording) as file,
        RecordingWriter(file, array, note=note, facts=facts, zstd=arguments.zstd) as writer,
        progress("importing", total) as advance,
    ):
        for block in table.blocks(array.name, arguments.repeat, arguments.rate, arguments.seed):
            writer.write(block)
            advance(len(block))
    megabytes = arguments.recording.stat().st_size / 1e6
    print(
        f"{arguments.recording}: {total} frames of {len(np.unique(table.ue))} UEs, "
        f"{array.antennas} antennas x {array.subcarriers} subcarriers, {megabytes:.1f} MB, "
        f"from {captures[0].format}"
    )
    lines = report.lines(parts, table, array, facts, remarks, band.antenna_names)
    width = max(len(name) for name, _ in lines)
    for name, value in lines:
        print(f"{name:<{width}}  {value}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Options that make no sense, whatever the files hold."""
    if not (math.isfinite(arguments.rate) and arguments.rate > 0):
        raise SetupError(f"--rate {arguments.rate:g}: must be a number > 0")
    if arguments.snr_db is not None and not math.isfinite(arguments.snr_db):
        raise SetupError(f"--snr-db {arguments.snr_db:g}: must be a number")
    if arguments.time and arguments.repeat > 1:
        raise SetupError("--time and --repeat exclude each other: repeated frames have no time of their own")
    if arguments.ue and arguments.ue_mac is not None:
        raise SetupError("--ue and --ue-mac exclude each other")
    if arguments.position and arguments.position_from:
        raise SetupError("--position and --position-from exclude each other")
    if any(isinstance(place, str) for place in arguments.position) and len(arguments.position) > 1:
        raise SetupError("--position is one variable, or X,Y,Z once a file")
    z_m = (arguments.array_position or (0.0, 0.0, 10.0))[2]
    arguments.plane_m = z_m - (arguments.height_m or z_m)


def _wifi(captures: list[Capture], arguments: argparse.Namespace) -> tuple[list[Part], Band, CaptureFacts]:
    found = [capture for capture in captures if isinstance(capture, WifiCapture)]
    if arguments.axes and arguments.axes.split(",") != list(found[0].axes):
        raise SetupError(f"--axes {arguments.axes}: those of {found[0].format} are {','.join(found[0].axes)}")
    if arguments.conjugate or arguments.fftshift or arguments.take or arguments.shape:
        raise SetupError("--conjugate, --fftshift, --take, --shape are for arrays, not for Wi-Fi")
    kind, others = wifi.chosen(found, arguments)
    power = wifi.power_of(found, kind, arguments.power)
    read = [wifi.part_of(capture, kind, power, arguments) for capture in found if wifi.has(capture, kind)]
    parts = [part for part, _ in read]
    parts[-1].remarks += others
    _place(parts, arguments)
    for part in parts:
        part.take(np.arange(len(part.ue))[arguments.frames])
        if not len(part.ue):
            raise SetupError(f"{part.source}: --frames: nothing is left")
    senders: dict[int, str] = {}
    if arguments.ue in (None, "ue") and any(capture.log.has_senders for capture in found):
        ues = np.unique(np.concatenate([part.ue for part in parts])).tolist()
        senders = {ue: mac(ue) if ue or _sent_by_zero(found) else "not said" for ue in ues}
    elif arguments.ue_mac is not None:
        senders = {arguments.ue_mac: mac(arguments.ue_mac)}
    facts = CaptureFacts(arguments.phase or "random", arguments.delay or "relative", power, senders)
    return parts, read[0][1], facts


def _arrays(captures: list[Capture], arguments: argparse.Namespace) -> tuple[list[Part], Band, CaptureFacts]:
    if arguments.power not in ("auto", "raw"):
        raise SetupError("--power rssi and agc are for Wi-Fi captures; arrays say nothing of power")
    read = [arrays.part_of(capture, arguments) for capture in captures]
    parts = [part for part, _ in read]
    shapes = {part.csi.shape[1:]: part.source for part in parts}
    if len(shapes) > 1:
        told = ", ".join(f"{source.name}: {shape[0]} x {shape[1]}" for shape, source in shapes.items())
        raise SetupError(f"the files differ in antennas x subcarriers ({told})")
    _place(parts, arguments)
    facts = CaptureFacts(arguments.phase or "steady", arguments.delay or "absolute")
    return parts, read[0][1], facts


def _place(parts: list[Part], arguments: argparse.Namespace) -> None:
    """Give each part the place that the options say."""
    sources = [part.source for part in parts]
    if arguments.position_from:
        given = places.of_table(arguments.position_from, sources, arguments.plane_m)
    elif arguments.position and not isinstance(arguments.position[0], str):
        given = arguments.position * len(parts) if len(arguments.position) == 1 else arguments.position
        if len(given) != len(parts):
            raise SetupError(f"--position is given {len(given)} times for {len(parts)} files")
    else:
        if arguments.position and isinstance(parts[0].source, Path) and parts[0].position is None:
            raise SetupError(
                f"--position {arguments.position[0]}: must be X,Y,Z; the file holds no positions"
            )
        return
    try:
        known = places.in_metres(np.array(given), arguments.position_unit, arguments.origin)
    except ValueError as error:
        raise SetupError(f"--position: {error}") from None
    for part, place in zip(parts, known, strict=True):
        part.position = places.repeated(place, len(part.ue))


def _sent_by_zero(captures: list[WifiCapture]) -> bool:
    """Whether 00:00:00:00:00:00 is an address that stands in the file: ESP32 logs always say one."""
    return all(capture.format.startswith("ESP32") for capture in captures)
