"""The frames of a capture, as the options of `chachart import` pick and describe them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from chachart.config.describe import allowed
from chachart.config.settings import ArraySettings
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.formats.arrange import (
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


@dataclass(frozen=True, slots=True)
class CaptureTable:
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


def read_table(arguments: argparse.Namespace, capture: Capture) -> tuple[ArrayGeometry, CaptureTable]:
    """The array that the options describe, and the frames that they pick.

    Raises
    ------
    SetupError
        If a variable is missing or does not fit, a frame is bad, or the array makes no sense.
    """
    axes = arguments.axes.split(",") if arguments.axes else capture.axes
    whole = _converted(
        capture,
        "--csi",
        arguments.csi,
        lambda v: frames(v if arguments.shape is None else v.reshape(arguments.shape), axes),
    )
    count, picked = len(whole), arguments.frames
    csi = whole[picked, :, arguments.subcarriers]
    if csi.size == 0:
        raise SetupError(f"--frames, --subcarriers: nothing is left of shape {whole.shape}")
    array = _geometry(arguments, whole.shape, csi.shape)
    ue = np.arange(count, dtype=np.uint64)
    if arguments.ue:
        ue = _converted(capture, "--ue", arguments.ue, lambda v: identities(column(v, count)))
    time_ns = position = None
    if arguments.time:
        time_ns = _converted(capture, "--time", arguments.time, lambda v: times_ns(column(v, count)))[picked]
    if arguments.position:
        plane = array.position_m[2] - (array.height_m or array.position_m[2])
        known = _converted(capture, "--position", arguments.position, lambda v: positions(v, count, plane))
        position = known[picked]
    return array, _table(arguments, capture, csi, ue[picked], time_ns, position)


def _table(
    arguments: argparse.Namespace,
    capture: Capture,
    csi: NDArray[np.complex64],
    ue: NDArray[np.uint64],
    time_ns: NDArray[np.int64] | None,
    position: NDArray[np.float32] | None,
) -> CaptureTable:
    found = defects(csi)
    bad = np.flatnonzero(found != "")
    if len(bad) and not arguments.skip_bad:
        number = range(arguments.frames.start or 0, 2**63, arguments.frames.step or 1)[bad[0]]
        others = f", as are {len(bad) - 1} others" if len(bad) > 1 else ""
        raise SetupError(
            f'{capture.path}: frame {number} of "{arguments.csi}" {found[bad[0]]}{others} '
            f"(--skip-bad leaves such frames out); the file has {capture.listing()}"
        )
    if len(bad) == len(csi):
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
    return CaptureTable(
        csi,
        ue[good],
        None if time_ns is None else time_ns[good],
        None if position is None else position[good],
        noise_std,
        f", {len(bad)} bad frames left out" if len(bad) else "",
    )


def _geometry(
    arguments: argparse.Namespace, whole: tuple[int, ...], picked: tuple[int, ...]
) -> ArrayGeometry:
    """The array of the picked subcarriers, from options that describe the whole."""
    if whole[2] > 1 and arguments.subcarrier_spacing_hz is None:
        raise SetupError(f"--subcarrier-spacing-hz is needed: the file has {whole[2]} subcarriers")
    spacing, first = arguments.subcarrier_spacing_hz, arguments.subcarriers.start or 0
    values = {
        "name": arguments.array_name,
        "antennas": picked[1],
        "subcarriers": picked[2],
        "carrier_hz": arguments.carrier_hz + first * (spacing or 0.0),
        "subcarrier_spacing_hz": spacing and spacing * (arguments.subcarriers.step or 1),
        "position_m": arguments.array_position,
        "axis": arguments.array_axis,
        "broadside": arguments.array_broadside,
        "element_spacing_m": arguments.element_spacing_m,
        "height_m": arguments.height_m,
        "light_speed_m_s": arguments.light_speed_m_s,
    }
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
