"""Find an array's calibration from frames of a UE at a known place, or check one that there is.

    chachart calibrate capture.mcap --ue 7 -o cal.toml                         place as in the recording
    chachart calibrate capture.mcap --ue 7 --position 120.5,-33,1.5 -o cal.toml
    chachart calibrate capture.mcap --check cal.toml                           how good is it still?

`calibration = "cal.toml"` in [array] then makes a node undo it. Swapped cables are found by comparing UEs in
different places, known or not: the more the capture has, the surer.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.shared.cli import progress
from chachart.node.data.calibration import Calibration
from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation import calibrate
from chachart.node.files.calibration import load_calibration, save_calibration
from chachart.node.files.recording import RecordingReader
from chachart.sources.checks import usable

MAX_UES = 256
"""UEs that are compared with the reference; more add nothing."""
MAX_REFERENCE_FRAMES = 4096
MAX_PLACES = 64
PRODUCT_BYTES = 64 << 20
DEAD = 1e-6
"""An input with so much less power than the median one is not connected."""
STANDS_OUT = 3.0
"""An antenna so many times further off than the median one is named ..."""
MIN_OFF_RAD = np.radians(10.0)
"""... if it is off by more than this."""


@dataclass(slots=True)
class Capture:
    """What a recording holds, as far as calibrating needs it.

    Attributes
    ----------
    ues, covariance, position
        Up to `MAX_UES` UEs (P,), the sums of their covariances (P, N_R, N_R), last known positions (P, 3).
    frames, places
        Frames of the reference UEs (F, N_R, N_S), and where they were (F, 3), NaN where unknown.
    """

    ues: NDArray[np.uint64]
    covariance: NDArray[np.complex128]
    position: NDArray[np.float64]
    frames: NDArray[np.complex64]
    places: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Finding:
    """What is known of an array after looking at a capture.

    Attributes
    ----------
    calibration
        The calibration.
    swapped
        Cycles of antennas that are connected to one another's inputs; a swap is a pair.
    sure
        Whether more than one place says so.
    before_rad, after_rad
        Rms phase (N_R,) by which each antenna is off the wave that the others see, without and with it.
    """

    calibration: Calibration
    swapped: list[tuple[int, ...]]
    sure: bool
    before_rad: NDArray[np.float64]
    after_rad: NDArray[np.float64]

    @property
    def suspects(self) -> list[int]:
        """Antennas that are off even so."""
        limit = max(STANDS_OUT * float(np.median(self.after_rad)), MIN_OFF_RAD)
        return [int(n) for n in np.flatnonzero(self.after_rad > limit)]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart calibrate`."""
    parser.add_argument("recording", type=Path, metavar="FILE.mcap", help="a capture, as the array gave it")
    parser.add_argument("--ue", type=_ue, action="append", default=[], help="a UE whose place is known")
    parser.add_argument("--position", type=_position, metavar="X,Y,Z", help="its place, world metres")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="CAL.toml", help="where to write the calibration"
    )
    parser.add_argument("--check", type=Path, metavar="CAL.toml", help="only see how well this one fits")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the report as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate or check.

    Raises
    ------
    SetupError
        If the recording does not hold what is needed, or a file cannot be read or written.
    """
    if bool(arguments.ue) == bool(arguments.check):
        raise SetupError("say either --ue ID, whose place is known, or --check CAL.toml")
    if arguments.position is not None and len(arguments.ue) > 1:
        raise SetupError("--position is the place of one UE; give --ue once")
    reader = RecordingReader(arguments.recording)
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


def read(reader: RecordingReader, references: list[int]) -> Capture:
    """Go through the recording once.

    Raises
    ------
    SetupError
        If a reference UE is not in it, an input measures nothing, or it is empty.
    """
    n = reader.array.antennas
    slots: dict[int, int] = {}
    covariance = np.zeros((MAX_UES, n, n), np.complex128)
    position = np.full((MAX_UES, 3), np.nan)
    kept: list[CsiBlock] = []
    wanted = np.array(references, np.uint64)
    with progress("reading", reader.summary().frames) as advance:
        for every in reader.blocks():
            advance(len(every))
            block = usable(every, Counters())
            if block is None:
                continue
            ues, which = np.unique(block.ue, return_inverse=True)
            for ue in ues.tolist():
                if ue in references or len(slots) < MAX_UES - len(references):
                    slots.setdefault(ue, len(slots))
            index = np.array([slots.get(ue, -1) for ue in ues.tolist()])[which]
            step = max(1, PRODUCT_BYTES // (16 * n * n))
            in_order = np.argsort(index, kind="stable")[np.count_nonzero(index < 0) :]
            for start in range(0, len(in_order), step):
                rows = in_order[start : start + step]
                csi = block.csi[rows]
                there, first = np.unique(index[rows], return_index=True)
                covariance[there] += np.add.reduceat(csi @ csi.conj().transpose(0, 2, 1), first)
            if block.position is not None:
                position[index[index >= 0]] = block.position[index >= 0]
            mine = np.isin(block.ue, wanted)
            if mine.any() and sum(map(len, kept)) < MAX_REFERENCE_FRAMES:
                kept.append(block.take(mine))
    if not slots:
        raise SetupError(f"{reader.path} holds no frame that can be used")
    if missing := [ue for ue in references if ue not in slots]:
        some = ", ".join(map(str, sorted(slots)[:10]))
        raise SetupError(f"{reader.path} has no frame of UE {missing[0]}; it has {some}, ...")
    power = np.einsum("pnn->n", covariance).real
    if dead := np.flatnonzero(power < DEAD * np.median(power)).tolist():
        raise SetupError(f"{reader.path}: input {', '.join(map(str, dead))} measures nothing")
    p = len(slots)
    reference = CsiBlock.concatenate(kept) if kept else None
    return Capture(
        np.array(list(slots), np.uint64),
        covariance[:p],
        position[:p],
        np.zeros((0, n, reader.array.subcarriers), np.complex64) if reference is None else reference.csi,
        _places(reference),
    )


def find(array: ArrayGeometry, capture: Capture, references: list[int]) -> Finding:
    """The calibration of `array`, from frames of the reference UEs, and from all others for the order.

    Raises
    ------
    SetupError
        If the place of a reference UE is not known, or it stands in the array.
    """
    known = np.isfinite(capture.places).all(axis=1)
    if not known.any():
        raise SetupError(f"where UE {references[0]} was is not in the recording; say --position X,Y,Z")
    frames, places = capture.frames[known], capture.places[known]
    unique, which = np.unique(places, axis=0, return_inverse=True)
    unique = unique[:MAX_PLACES]
    if np.linalg.norm(array.element_positions() - unique[:, None], axis=2).min() < array.wavelength_m:
        raise SetupError("the UE is closer than a wavelength to an antenna: is --position in world metres?")
    measured = np.stack([calibrate.coherent_mean(frames[which.ravel() == i]) for i in range(len(unique))])
    expected = calibrate.spherical(array, unique)
    order, sure = _order(array, capture, measured[0], expected[0])
    calibration = calibrate.responses(measured, expected, order)
    return _finding(array, capture, calibration, order, sure)


def check(array: ArrayGeometry, capture: Capture, calibration: Calibration) -> Finding:
    """How well `calibration` fits a capture, and whether cables have been swapped since.

    Raises
    ------
    ValueError
        If it is of another array.
    """
    if (calibration.antennas, calibration.subcarriers) != (array.antennas, array.subcarriers):
        raise ValueError(
            f"the calibration is of {calibration.antennas} antennas and {calibration.subcarriers} "
            f"subcarriers, the recording of {array.antennas} and {array.subcarriers}"
        )
    phasors = _corrected(calibration, calibrate.signatures(capture.covariance))
    alone = np.ones(array.antennas, np.complex128)
    order = calibrate.find_order(array, phasors, alone, capture.position)
    return _finding(array, capture, calibration, order, sure=len(phasors) > 1)


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
    for cycle in finding.swapped:
        names = " and ".join(map(str, cycle)) if len(cycle) == 2 else " -> ".join(map(str, cycle))
        verb = "are swapped" if len(cycle) == 2 else "are connected in a circle"
        told = "" if checked else "; the calibration puts it right"
        doubt = "" if finding.sure else " (judging from one place; a UE elsewhere would settle it)"
        print(f"antennas {names} {verb}{told}{doubt}")
    for n in finding.suspects:
        print(f"antenna {n} is {np.degrees(finding.after_rad[n]):.0f} deg off: a bad cable or element?")
    if not finding.swapped and not finding.suspects:
        print("no antenna stands out")


def as_json(finding: Finding) -> dict[str, Any]:
    """The report as plain values."""
    return {
        "swapped": [list(cycle) for cycle in finding.swapped],
        "sure": finding.sure,
        "suspects": finding.suspects,
        "off_before_deg": np.degrees(finding.before_rad).round(3).tolist(),
        "off_after_deg": np.degrees(finding.after_rad).round(3).tolist(),
        "calibration": finding.calibration.as_dict(),
    }


def _order(
    array: ArrayGeometry, capture: Capture, measured: NDArray[Any], expected: NDArray[Any]
) -> tuple[tuple[int, ...], bool]:
    """The order of the antennas, and whether more than one place speaks for it."""
    covariance = np.concatenate([capture.covariance, [measured @ measured.conj().T]])
    phasors = calibrate.signatures(covariance)
    others, reference = phasors[:-1], phasors[-1]
    ratio = others * reference.conj()
    # UEs that stand where the reference does say nothing: their ratio to it is the same at all antennas.
    elsewhere = np.abs(ratio.mean(axis=1)) < 0.9
    wave = expected[:, 0] / np.abs(expected[:, 0])
    if elsewhere.any():
        ratio, position = ratio[elsewhere], capture.position[elsewhere]
        return calibrate.find_order(array, ratio, wave, position), True
    error = reference * wave.conj()
    common = np.angle(error.sum())
    swapped = np.angle(reference[None, :] * wave.conj()[:, None] * np.exp(-1j * common))
    return calibrate.suspect_order(np.diag(swapped).copy(), swapped), False


def _finding(
    array: ArrayGeometry, capture: Capture, calibration: Calibration, order: tuple[int, ...], sure: bool
) -> Finding:
    raw = calibrate.signatures(capture.covariance)
    return Finding(
        calibration,
        calibrate.cycles(order),
        sure,
        calibrate.deviations(array, raw, capture.position),
        calibrate.deviations(array, _corrected(calibration, raw), capture.position),
    )


def _corrected(calibration: Calibration, phasors: NDArray[Any]) -> NDArray[np.complex128]:
    turned: NDArray[np.complex128] = phasors[:, list(calibration.antenna_order)] * np.exp(
        -1j * np.asarray(calibration.antenna_phase_rad)
    )
    return turned


def _places(block: CsiBlock | None) -> NDArray[np.float64]:
    if block is None:
        return np.zeros((0, 3))
    if block.position is None:
        return np.full((len(block), 3), np.nan)
    return block.position.astype(np.float64)


def _position(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in text.split(","))
        if not np.isfinite((x, y, z)).all():
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not X,Y,Z in metres") from None
    return x, y, z


def _ue(text: str) -> int:
    if not text.isdecimal() or int(text) >= 1 << 64:
        raise argparse.ArgumentTypeError(f"{text} is no UE id (0 to 2^64 - 1)")
    return int(text)
