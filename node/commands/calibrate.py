"""Find an array's calibration from frames of a UE at a known place, or check one that there is.

    chachart calibrate capture.mcap --ue 7 -o cal.toml                         place as in the recording
    chachart calibrate capture.mcap --ue 7 --position 120.5,-33,1.5 -o cal.toml
    chachart calibrate capture.mcap --check cal.toml                           how good is it still?
    chachart calibrate capture.mcap --offsets reftx-offsets.json -o cal.toml   take over sto and cpo
    chachart calibrate capture.mcap --offsets boards.npy -o cal.toml           or what pyespargos saved
    chachart calibrate capture.mcap --per-start --corrected undone.mcap        chains that flip between starts
    chachart calibrate hall.mcap --arrays -o arrays.toml                       poses and clocks of several
    chachart calibrate hall.mcap --arrays --places places.csv -o arrays.toml   places: ue,x,y,z[,time]

`calibration = "cal.toml"` in [array] then makes a node undo it. Swapped cables are found by comparing UEs in
different places, known or not: the more the capture has, the surer. Cards whose chains turn by 180 degrees
from one start to the next (each file of an import is one) are first put right with --per-start: by a UE at
known places (--ue), or by all, blind, up to a turn.

With --arrays, `calibration = "arrays.toml"` in [fusion] makes a node put its arrays where they are, and take
off what their clocks are late.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from chachart.node.commands.shared import placing, starts
from chachart.node.commands.shared.calibrating import Finding, check, find, read
from chachart.node.commands.shared.cli import check_writable
from chachart.node.data.errors import SetupError
from chachart.node.files.calibration import load_calibration, load_offsets, load_response, save_calibration
from chachart.node.files.placements import save_placements
from chachart.node.files.recording import RecordingReader
from chachart.node.files.survey import read_survey


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart calibrate`."""
    parser.add_argument("recording", type=Path, metavar="FILE.mcap", help="a capture, as the array gave it")
    parser.add_argument("--ue", type=_ue, action="append", default=[], help="a UE whose place is known")
    parser.add_argument("--position", type=_position, metavar="X,Y,Z", help="its place, world metres")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="CAL.toml", help="where to write the calibration"
    )
    parser.add_argument(
        "--offsets",
        type=Path,
        metavar="FILE",
        help="take over sto and cpo of DICHASUS data (.json) or what pyespargos saved of boards (.npy)",
    )
    parser.add_argument("--band", type=int, metavar="N", help="subcarriers of the whole band, for --offsets")
    parser.add_argument("--channels", type=_channels, metavar="6,2,16,...", help="the array's, for --offsets")
    parser.add_argument("--check", type=Path, metavar="CAL.toml", help="only see how well this one fits")
    parser.add_argument(
        "--per-start", action="store_true", help="find chains turned by 180 degrees, start by start"
    )
    parser.add_argument(
        "--corrected",
        type=Path,
        metavar="OUT.mcap",
        help="with --per-start: the recording without these turns",
    )
    parser.add_argument(
        "--arrays", action="store_true", help="find where several arrays are, and how late their clocks"
    )
    parser.add_argument(
        "--places", type=Path, metavar="CSV", help="with --arrays: places of UEs (ue,x,y,z[,time])"
    )
    parser.add_argument(
        "--clock", choices=("shared", "offset", "own"), help="with --arrays: as in [fusion], instead of auto"
    )
    parser.add_argument("--clocks-only", action="store_true", help="with --arrays: poses are as described")
    parser.add_argument("--force", action="store_true", help="replace OUT.mcap if it exists")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the report as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate or check.

    Raises
    ------
    SetupError
        If the recording does not hold what is needed, or a file cannot be read or written.
    """
    if arguments.arrays:
        return _arrays(arguments)
    if arguments.places is not None or arguments.clock is not None or arguments.clocks_only:
        raise SetupError("--places, --clock and --clocks-only go with --arrays")
    if arguments.per_start:
        return _per_start(arguments)
    if arguments.corrected is not None:
        raise SetupError("--corrected goes with --per-start; a calibration is undone by [array] calibration")
    if sum(map(bool, (arguments.ue, arguments.check, arguments.offsets))) != 1:
        raise SetupError("say either --ue ID, whose place is known, --check CAL.toml or --offsets FILE")
    if arguments.position is not None and len(arguments.ue) > 1:
        raise SetupError("--position is the place of one UE; give --ue once")
    reader = RecordingReader(arguments.recording)
    if arguments.offsets is not None:
        return _take_over(arguments, reader)
    capture = read(reader, arguments.ue)
    if arguments.check is not None:
        try:
            finding = check(reader.array, capture, load_calibration(arguments.check))
        except ValueError as error:
            raise SetupError(str(error)) from None
    else:
        if arguments.position is not None:
            capture.places[:] = arguments.position
        finding = find(reader.array, capture, arguments.ue)
    show(finding, checked=arguments.check is not None)
    try:
        if arguments.output is not None:
            ues = ", ".join(map(str, arguments.ue))
            note = f"chachart calibrate {arguments.recording.name}: {len(capture.frames)} frames of UE {ues}"
            save_calibration(arguments.output, finding.calibration, note)
        if arguments.json is not None:
            arguments.json.write_text(json.dumps(as_json(finding), indent=2) + "\n")
    except OSError as error:
        raise SetupError(f"{error.filename} cannot be written: {error.strerror}") from None
    return 0


def _take_over(arguments: argparse.Namespace, reader: RecordingReader) -> int:
    if arguments.output is None:
        raise SetupError("--offsets needs -o CAL.toml, where to write the calibration")
    path, channels = arguments.offsets, arguments.channels
    try:
        if path.suffix == ".npy":
            calibration = load_response(path, reader.array, channels)
        else:
            calibration = load_offsets(path, reader.array, arguments.band, channels)
    except ValueError as error:
        raise SetupError(str(error)) from None
    save_calibration(arguments.output, calibration, f"chachart calibrate --offsets {arguments.offsets.name}")
    print(arguments.output)
    return 0


def _arrays(arguments: argparse.Namespace) -> int:
    """Find the poses of several arrays, and the offsets of their clocks."""
    others = ("position", "offsets", "check", "per_start", "corrected")
    if wrong := [f"--{name.replace('_', '-')}" for name in others if getattr(arguments, name)]:
        raise SetupError(f"{' and '.join(wrong)} cannot be had with --arrays (known places: --places CSV)")
    reader = RecordingReader(arguments.recording)
    try:
        survey = None if arguments.places is None else read_survey(arguments.places)
    except ValueError as error:
        raise SetupError(f"--places: {error}") from None
    found, clock = placing.placed(reader, survey, arguments.ue, arguments.clock, arguments.clocks_only)
    for line in placing.lines(found, clock):
        print(line)
    try:
        if arguments.output is not None:
            note = f"chachart calibrate --arrays {arguments.recording.name}, clock {clock}"
            save_placements(arguments.output, tuple(one.placement for one in found), note)
        if arguments.json is not None:
            arguments.json.write_text(json.dumps(placing.as_json(found, clock), indent=2) + "\n")
    except OSError as error:
        raise SetupError(f"{error.filename} cannot be written: {error.strerror}") from None
    return 0


def _per_start(arguments: argparse.Namespace) -> int:
    """Find which chains have turned at each start, and write a recording without it."""
    if arguments.check is not None or arguments.output is not None:
        raise SetupError("--per-start goes with --ue, --position, --corrected and --json only")
    if arguments.corrected is not None:
        check_writable(arguments.corrected, arguments.force, arguments.recording)
    reader = RecordingReader(arguments.recording)
    found = starts.calibrated_starts(reader, arguments.ue, arguments.position)
    for line in starts.lines(found):
        print(line)
    if arguments.corrected is not None:
        starts.write_without_flips(reader, found, arguments.corrected)
        print(f"{arguments.corrected}: all starts as the first; its note names what was turned")
    if arguments.json is not None:
        try:
            arguments.json.write_text(json.dumps(starts.as_json(found), indent=2) + "\n")
        except OSError as error:
            raise SetupError(f"{error.filename} cannot be written: {error.strerror}") from None
    return 0


def show(finding: Finding, checked: bool) -> None:
    """Print the report."""
    c = finding.calibration
    print("antenna  input   gain dB  phase deg   off before   off after (deg rms)")
    columns = zip(c.antenna_gain, c.antenna_phase_rad, finding.before_rad, finding.after_rad, strict=True)
    for n, (gain, phase, before, after) in enumerate(columns):
        print(
            f"{n:7d} {c.antenna_order[n]:6d} {20 * np.log10(gain):9.2f} {np.degrees(phase):10.1f} "
            f"{np.degrees(before):12.1f} {np.degrees(after):11.1f}"
        )
    if finding.wrong is not None:
        told = "" if checked else "; the calibration puts it right, a better [array] would, too"
        print(f"the array is not as described: {finding.wrong}{told}")
    if c.antenna_delay_s:
        late = 1e9 * np.array(c.antenna_delay_s)
        print("delays in ns: " + " ".join(f"{delay:.2f}" for delay in late))
    if finding.silent:
        print(f"subcarriers {', '.join(map(str, finding.silent))} carry nothing and are left as they are")
    for cycle in finding.swapped:
        names = " and ".join(map(str, cycle)) if len(cycle) == 2 else " -> ".join(map(str, cycle))
        verb = "are swapped" if len(cycle) == 2 else "are connected in a circle"
        told = "" if checked else "; the calibration puts it right"
        doubt = "" if finding.sure else " (judging from one place; a UE elsewhere would settle it)"
        print(f"antennas {names} {verb}{told}{doubt}")
    for n in finding.suspects:
        print(f"antenna {n} is {np.degrees(finding.after_rad[n]):.0f} deg off: a bad cable or element?")
    if not finding.swapped and not finding.suspects and finding.wrong is None:
        print("no antenna stands out")


def as_json(finding: Finding) -> dict[str, Any]:
    """The report as plain values."""
    return {
        "wrong": finding.wrong,
        "swapped": [list(cycle) for cycle in finding.swapped],
        "sure": finding.sure,
        "suspects": finding.suspects,
        "silent": finding.silent,
        "off_before_deg": np.degrees(finding.before_rad).round(3).tolist(),
        "off_after_deg": np.degrees(finding.after_rad).round(3).tolist(),
        "calibration": finding.calibration.as_dict(),
    }


def _position(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in text.split(","))
        if not np.isfinite((x, y, z)).all():
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not X,Y,Z in metres") from None
    return x, y, z


def _channels(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(word) for word in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not a list of channel numbers") from None


def _ue(text: str) -> int:
    if not text.isdecimal() or int(text) >= 1 << 64:
        raise argparse.ArgumentTypeError(f"{text} is no UE id (0 to 2^64 - 1)")
    return int(text)
