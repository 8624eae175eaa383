"""Calibration files: what `chachart calibrate` writes and `array.calibration` names. TOML."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Literal

import numpy as np
import tomli_w
from pydantic import Field, ValidationError

from chachart.node.data.calibration import Calibration
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.settings import Settings


class AntennaTable(Settings):
    """Per element of the array, in its order."""

    order: tuple[int, ...]
    """The input that each element is connected to."""
    gain_db: tuple[float, ...]
    """Gain of its way to the receiver."""
    phase_deg: tuple[float, ...]
    """Phase of its way to the receiver."""
    delay_ns: tuple[float, ...] = ()
    """How much later its way is than the others'; left out: none is."""


class SubcarrierTable(Settings):
    """Per subcarrier, common to all antennas."""

    gain_db: tuple[float, ...]
    """Gain."""
    phase_deg: tuple[float, ...]
    """Phase; a delay is a slope of it."""


class CalibrationFile(Settings):
    """A calibration as it is kept."""

    version: Literal[1] = 1
    """Of this format."""
    note: str = Field("", max_length=1000)
    """Where it comes from, for people."""
    antenna: AntennaTable
    """Order and response of the antennas."""
    subcarrier: SubcarrierTable
    """Response of the subcarriers."""


def load_calibration(path: Path) -> Calibration:
    """The calibration in a file.

    Raises
    ------
    ValueError
        If the file cannot be read or holds none.
    """
    try:
        document = tomllib.loads(path.read_text("utf-8"))
        file = CalibrationFile.model_validate(document)
        return Calibration(
            file.antenna.order,
            tuple(10 ** (db / 20) for db in file.antenna.gain_db),
            tuple(math.radians(d) for d in file.antenna.phase_deg),
            tuple(10 ** (db / 20) for db in file.subcarrier.gain_db),
            tuple(math.radians(d) for d in file.subcarrier.phase_deg),
            tuple(1e-9 * delay for delay in file.antenna.delay_ns),
        )
    except OSError as error:
        raise ValueError(f"calibration {path} cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ValueError(f"{path} is no calibration: {where}: {first['msg']}") from None
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path} is no calibration: {error}") from None


def load_offsets(
    path: Path, array: ArrayGeometry, band: int | None = None, channels: tuple[int, ...] | None = None
) -> Calibration:
    """The correction in a JSON file of DICHASUS data: lists `sto`, in samples, and `cpo`, in rad, by channel.

    The data become right times exp(j (2 pi sto k / N + cpo)), k the number of the tone, counted from
    the band's lowest: tones with numbers below 0 count from the middle.

    Parameters
    ----------
    path
        The file.
    array
        Whose antennas and tones these are.
    band
        N, subcarriers of the whole band; None: as many as the array has.
    channels
        Which channels are the array's elements; None: all in their order.

    Raises
    ------
    ValueError
        If the file cannot be read, or holds none of this array.
    """
    try:
        document = json.loads(path.read_text("utf-8"))
        sto, cpo = (np.array(document[name], np.float64) for name in ("sto", "cpo"))
        pick = np.arange(len(sto)) if channels is None else np.array(channels)
        sto, cpo = sto[pick], cpo[pick]
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from None
    except (KeyError, TypeError, ValueError, IndexError):
        raise ValueError(f'{path} must hold lists "sto" and "cpo", one number a channel') from None
    if len(sto) != array.antennas:
        raise ValueError(f"{path} is of {len(sto)} channels, the array has {array.antennas}: say which")
    whole = band or array.subcarriers
    lowest = whole // 2 if array.tone_numbers.min() < 0 else 0
    cpo = cpo + 2 * np.pi / whole * (sto - sto.mean()) * lowest
    common = np.exp(-2j * np.pi / whole * sto.mean() * (array.tone_numbers + lowest))
    delay_s = (sto - sto.mean()) / (whole * array.subcarrier_spacing_hz)
    return Calibration.of(np.arange(len(sto)), np.exp(-1j * cpo), common, delay_s)


def load_response(path: Path, array: ArrayGeometry, channels: tuple[int, ...] | None = None) -> Calibration:
    """The phases in a `.npy` file of pyespargos' combined-array-calibration: (boards, rows, columns, tones).

    The file holds what the antennas gave of one reference; as there, phases alone count. Tones are numbered
    from minus to plus half their number, the middle one included. What antennas differ in is a phase and a
    delay each; what is left at each tone is common to all.

    Parameters
    ----------
    path
        The file.
    array
        Whose antennas and tones these are.
    channels
        Which antennas, counted board by board and row by row, are the array's elements; None: all in order.

    Raises
    ------
    ValueError
        If the file cannot be read, or holds none of this array.
    """
    try:
        with path.open("rb") as file:
            response = np.load(file, allow_pickle=False)
        flat = response.reshape(-1, response.shape[-1]).astype(np.complex128)
        flat = flat if channels is None else flat[list(channels)]
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror or error}") from None
    except (ValueError, EOFError, IndexError, TypeError):
        raise ValueError(
            f"{path} must be an array (boards, rows, columns, tones) of complex numbers"
        ) from None
    if len(flat) != array.antennas:
        raise ValueError(f"{path} is of {len(flat)} antennas, the array has {array.antennas}: say which")
    numbers = array.tone_numbers
    at = np.arange(array.subcarriers) if array.tones is None else numbers + flat.shape[1] // 2
    if at.min() < 0 or at.max() >= flat.shape[1] or (array.tones is None and len(at) != flat.shape[1]):
        raise ValueError(f"{path} has {flat.shape[1]} tones, not the array's {numbers[0]} to {numbers[-1]}")
    flat = flat[:, at]
    if not (np.isfinite(flat) & (flat != 0)).all():
        raise ValueError(f"{path} has antennas or tones without a phase")
    flat = flat / np.abs(flat)
    other = flat * flat[0].conj()
    gaps = np.diff(numbers)
    even = gaps == gaps.min()
    steps = (other[:, 1:] * other[:, :-1].conj())[:, even].sum(axis=1)
    slope = np.angle(steps) / gaps.min()
    # The steps' mean is of neighbours; the whole band tells the rest of the slope more exactly.
    for _ in range(2):
        left = other * np.exp(-1j * slope[:, None] * numbers)
        left *= left.mean(axis=1, keepdims=True).conj()
        centred = numbers - numbers.mean()
        slope = slope + np.angle(left) @ centred / (centred @ centred)
    slope -= slope.mean()
    phases = (other * np.exp(-1j * (slope - slope[0])[:, None] * numbers)).mean(axis=1)
    antenna = phases / np.abs(phases)
    common = (flat * (antenna[:, None] * np.exp(1j * slope[:, None] * numbers)).conj()).mean(axis=0)
    delay_s = -slope / (2 * np.pi * array.subcarrier_spacing_hz)
    return Calibration.of(np.arange(len(flat)), antenna, common / np.abs(common), delay_s)


def save_calibration(path: Path, calibration: Calibration, note: str) -> None:
    """Write a calibration to a file.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    c = calibration
    document = {
        "version": 1,
        "note": note,
        "antenna": {
            "order": c.antenna_order,
            "gain_db": _db(c.antenna_gain),
            "phase_deg": _degrees(c.antenna_phase_rad),
            **({"delay_ns": [round(1e9 * d, 6) for d in c.antenna_delay_s]} if c.antenna_delay_s else {}),
        },
        "subcarrier": {"gain_db": _db(c.subcarrier_gain), "phase_deg": _degrees(c.subcarrier_phase_rad)},
    }
    path.write_text(tomli_w.dumps(document), "utf-8")


def _db(gains: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(round(20 * math.log10(g), 5) for g in gains)


def _degrees(phases: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(round(math.degrees(p), 4) for p in phases)
