"""The array of an import: what the file says, what the options say, and where they contradict each other."""

from __future__ import annotations

import argparse

import numpy as np
from pydantic import ValidationError

from chachart.config.describe import allowed
from chachart.config.settings import ArraySettings
from chachart.node.commands.importing.table import Band, Part
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry

DEAD, WEAK_DB = 1e-9, 20.0
"""So much less power than the median is none; so many dB less is told."""
_APART = 1e-3
"""Up to so much, option and file mean the same frequency."""

_OPTIONS = {
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
    "tones": "--tones",
}


def geometry(parts: list[Part], band: Band, arguments: argparse.Namespace) -> tuple[ArrayGeometry, list[str]]:
    """The array that measured the frames, and what to tell of it.

    Raises
    ------
    SetupError
        If something is needed that neither file nor options say, or does not fit.
    """
    remarks: list[str] = []
    _, antennas, count = parts[0].csi.shape
    carrier = _agreed("--carrier-hz", arguments.carrier_hz, band.carrier_hz, arguments.override, remarks)
    spacing = _agreed(
        "--subcarrier-spacing-hz",
        arguments.subcarrier_spacing_hz,
        band.spacing_hz,
        arguments.override,
        remarks,
    )
    if carrier is None:
        raise SetupError("--carrier-hz is needed: the file does not say it (the middle of the channel)")
    if count > 1 and spacing is None:
        raise SetupError(f"--subcarrier-spacing-hz is needed: the file has {count} subcarriers")
    tones = band.tones
    if tones is None:
        carrier += (arguments.subcarriers.start or 0) * (spacing or 0.0)
        spacing = spacing and spacing * (arguments.subcarriers.step or 1)
    dead_antennas, dead_tones = _dead(parts, band, remarks)
    values = {
        "name": arguments.array_name,
        "antennas": antennas,
        "subcarriers": count,
        "carrier_hz": carrier,
        "subcarrier_spacing_hz": spacing,
        "position_m": arguments.array_position,
        "axis": arguments.array_axis,
        "broadside": arguments.array_broadside,
        "element_spacing_m": arguments.element_spacing_m,
        "height_m": arguments.height_m,
        "light_speed_m_s": arguments.light_speed_m_s,
        "tones": tones,
        "dead_antennas": dead_antennas,
        "dead_tones": dead_tones,
    }
    given = {name: value for name, value in values.items() if value is not None}
    try:
        return ArraySettings(**given).geometry(), remarks
    except ValidationError as error:
        lines = []
        for name in dict.fromkeys(str(detail["loc"][0]) for detail in error.errors()):
            rule = allowed(ArraySettings.model_fields[name])
            lines.append(f"{_OPTIONS.get(name, name)} {values[name]}: must be {rule}")
        raise SetupError("\n".join(lines)) from None
    except ValueError as error:
        what = "--tones" if "tone" in str(error) else "--array-axis, --array-broadside"
        raise SetupError(f"{what}: {error}") from None


def _agreed(
    option: str, said: float | None, known: float | None, override: bool, remarks: list[str]
) -> float | None:
    """What the option says or the file knows; the file is right unless it is to be overridden."""
    if said is None or known is None or abs(said - known) <= _APART * known:
        return said if known is None else known
    if override:
        remarks.append(f"{option} {said:g} overrides {known:g}, which the file says")
        return said
    remarks.append(
        f"{option} {said:g} contradicts the file, which says {known:g}: taken from the file (--override)"
    )
    return known


def _dead(parts: list[Part], band: Band, remarks: list[str]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Antennas and subcarriers without power, and subcarriers that the format says do not count."""
    _, antennas, count = parts[0].csi.shape
    power = np.zeros((antennas, count))
    for part in parts:
        for first in range(0, len(part.csi), 4096):
            power += np.square(np.abs(part.csi[first : first + 4096]), dtype=np.float64).sum(axis=0)
    by_antenna, by_tone = power.mean(axis=1), power.mean(axis=0)
    silent = np.flatnonzero(by_antenna <= DEAD * np.median(by_antenna)).tolist()
    names = band.antenna_names or tuple(map(str, range(antennas)))
    with np.errstate(divide="ignore"):
        below_db = 10 * np.log10(np.median(by_antenna)) - 10 * np.log10(by_antenna)
    remarks += [f"antenna {names[n]} measures nothing: it does not count" for n in silent]
    remarks += [
        f"antenna {names[n]} is {below_db[n]:.0f} dB weaker than the others"
        for n in range(antennas)
        if n not in silent and below_db[n] > WEAK_DB
    ]
    empty = set(np.flatnonzero(by_tone <= DEAD * np.median(by_tone)).tolist())
    weak = {n for n, tone in enumerate(band.tones or ()) if tone in band.weak}
    if empty - weak:
        remarks.append(
            f"{len(empty - weak)} subcarriers without power do not count: {_some(empty - weak, band)}"
        )
    if weak:
        remarks.append(f"{len(weak)} subcarriers do not count by the format: {_some(weak, band)}")
    dead = sorted(empty | weak)
    return tuple(silent if len(silent) < antennas else ()), tuple(dead if len(dead) < count else ())


def _some(indices: set[int], band: Band) -> str:
    numbers = [band.tones[n] if band.tones else n for n in sorted(indices)]
    return ", ".join(map(str, numbers[:12])) + (", ..." if len(numbers) > 12 else "")
