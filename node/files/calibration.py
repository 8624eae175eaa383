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
