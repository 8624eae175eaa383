"""From a recording to the calibration of its array: what is read of it, and what is found."""

from __future__ import annotations

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
from chachart.node.estimation import calibrate as fitting
from chachart.node.estimation.symmetries import symmetries
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
    wrong
        What is wrong with the description as a whole, mirrored or turned, in words; None if nothing is.
    swapped
        Besides that, cycles of antennas that are connected to one another's inputs; a swap is a pair.
    sure
        Whether more than one place says so.
    silent
        Subcarriers that carry nothing, and are left as they are.
    before_rad, after_rad
        Rms phase (N_R,) by which each antenna is off the wave that the others see, without and with it.
    """

    calibration: Calibration
    wrong: str | None
    swapped: list[tuple[int, ...]]
    sure: bool
    silent: list[int]
    before_rad: NDArray[np.float64]
    after_rad: NDArray[np.float64]

    @property
    def suspects(self) -> list[int]:
        """Antennas that are off even so."""
        limit = max(STANDS_OUT * float(np.median(self.after_rad)), MIN_OFF_RAD)
        return [int(n) for n in np.flatnonzero(self.after_rad > limit)]


def calibrate(path: str | Path, ue: int, position: tuple[float, float, float] | None = None) -> Calibration:
    """The calibration of a recording's array, from the frames of a UE at a known place.

    Parameters
    ----------
    path
        The recording, as the array gave it.
    ue
        Whose frames count; those of all others help to find swapped antennas.
    position
        Where that UE is, in world metres; None takes what the recording says.

    Raises
    ------
    SetupError
        If the recording does not hold what is needed.
    """
    reader = RecordingReader(Path(path))
    capture = read(reader, [ue])
    if position is not None:
        capture.places[:] = position
    return find(reader.array, capture, [ue]).calibration


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
                told = (index >= 0) & np.isfinite(block.position).all(axis=1)
                position[index[told]] = block.position[told]
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
        inputs = ", ".join(map(str, dead))
        raise SetupError(
            f"{reader.path}: input {inputs} measures nothing: a broken cable or antenna? "
            f"dead_antennas = {dead} in [array] goes on without it"
        )
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
    measured = np.stack([fitting.coherent_mean(frames[which.ravel() == i]) for i in range(len(unique))])
    expected = fitting.spherical(array, unique)
    order, sure = _order(array, capture, measured[0], expected[0])
    calibration = fitting.responses(measured, expected, order, array.offsets_hz)
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
    phasors = _corrected(calibration, fitting.signatures(capture.covariance))
    alone = np.ones(array.antennas, np.complex128)
    order = fitting.find_order(array, phasors, alone, capture.position)
    return _finding(array, capture, calibration, order, sure=len(phasors) > 1)


def _order(
    array: ArrayGeometry, capture: Capture, measured: NDArray[Any], expected: NDArray[Any]
) -> tuple[tuple[int, ...], bool]:
    """The order of the antennas, and whether more than one place speaks for it."""
    covariance = np.concatenate([capture.covariance, [measured @ measured.conj().T]])
    phasors = fitting.signatures(covariance)
    others, reference = phasors[:-1], phasors[-1]
    ratio = others * reference.conj()
    # UEs that stand where the reference does say nothing: their ratio to it is the same at all antennas.
    elsewhere = np.abs(ratio.mean(axis=1)) < 0.9
    wave = expected[:, 0] / np.abs(expected[:, 0])
    if elsewhere.any():
        ratio, position = ratio[elsewhere], capture.position[elsewhere]
        return fitting.find_order(array, ratio, wave, position), True
    error = reference * wave.conj()
    common = np.angle(error.sum())
    swapped = np.angle(reference[None, :] * wave.conj()[:, None] * np.exp(-1j * common))
    return fitting.suspect_order(np.diag(swapped).copy(), swapped), False


def described(array: ArrayGeometry, order: tuple[int, ...]) -> tuple[str | None, tuple[int, ...]]:
    """What is wrong with the description as a whole, and what of the order is left beside it."""
    best: tuple[str | None, tuple[int, ...]] = (None, order)
    fewest = sum(n != m for n, m in enumerate(order))
    for name, whole in symmetries(array).items():
        back = np.argsort(whole)
        rest = tuple(int(back[m]) for m in order)
        moved = sum(n != m for n, m in enumerate(rest))
        if moved < fewest // 2:
            best, fewest = (name, rest), moved
    return best


def _finding(
    array: ArrayGeometry, capture: Capture, calibration: Calibration, order: tuple[int, ...], sure: bool
) -> Finding:
    raw = fitting.signatures(capture.covariance)
    wrong, moved = described(array, order)
    return Finding(
        calibration,
        wrong,
        fitting.cycles(moved),
        sure,
        np.flatnonzero(fitting.silent(capture.frames)).tolist() if len(capture.frames) else [],
        fitting.deviations(array, raw, capture.position),
        fitting.deviations(array, _corrected(calibration, raw), capture.position),
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
