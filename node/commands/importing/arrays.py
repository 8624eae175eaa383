"""The frames of named arrays (NumPy, MATLAB, HDF5, TFRecord), as the options pick and describe them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.importing.places import in_metres
from chachart.node.commands.importing.table import Band, Part
from chachart.node.data.errors import SetupError
from chachart.sources.formats.arrange import column, frames, identities, positions, taken, times_ns
from chachart.sources.formats.base import Capture

Converted = TypeVar("Converted")


def part_of(capture: Capture, arguments: argparse.Namespace) -> tuple[Part, Band]:
    """The frames that the options pick from a capture, and how its subcarriers are numbered.

    Raises
    ------
    SetupError
        If a variable is missing or does not fit.
    """
    if arguments.csi is None:
        raise SetupError(
            f"--csi is needed: the variable with the CSI; {capture.path} has {capture.listing()}"
        )
    axes = arguments.axes.split(",") if arguments.axes else list(capture.axes)
    whole, each = _csi(capture, axes, arguments)
    if arguments.conjugate:
        whole = whole.conj()
    tones = _tones(whole.shape[2], arguments)
    if arguments.fftshift:
        whole = np.fft.fftshift(whole, axes=2)
    count, picked = len(whole), arguments.frames
    csi = whole[picked, :, arguments.subcarriers]
    if csi.size == 0:
        raise SetupError(f"--frames, --subcarriers: nothing is left of shape {whole.shape}")
    ue = np.repeat(np.arange(count // each, dtype=np.uint64), each)
    if arguments.ue is not None and arguments.ue.isdecimal() and arguments.ue not in capture.variables:
        ue = np.full(count, int(arguments.ue), np.uint64)
    elif arguments.ue_mac is not None:
        ue = np.full(count, arguments.ue_mac, np.uint64)
    elif arguments.ue:
        ue = _converted(capture, "--ue", arguments.ue, lambda v: identities(column(v, count, each)))
    time_ns = position = None
    if arguments.time:
        unit = arguments.time_unit
        time_ns = _converted(
            capture, "--time", arguments.time, lambda v: times_ns(column(v, count, each), unit)
        )
        time_ns = time_ns[picked]
    if arguments.position and isinstance(arguments.position[0], str):

        def placed(values: NDArray[Any]) -> NDArray[np.float32]:
            metres = in_metres(values, arguments.position_unit, arguments.origin)
            return positions(metres, count if len(values) == count else count // each, arguments.plane_m)

        known = _converted(capture, "--position", arguments.position[0], placed)
        position = known if len(known) == count else np.repeat(known, each, axis=0)
        position = position[picked]
    part = Part(
        capture.path,
        csi,
        ue[picked],
        time_ns,
        position,
        np.arange(count)[picked],
        frames_in_file=len(csi) + sum(capture.left_out.values()) - capture.left_out["cut short"],
        left_out=capture.left_out.copy(),
    )
    numbers = None if tones is None else tuple(tones[arguments.subcarriers])
    return part, Band(tones=numbers)


def _csi(
    capture: Capture, axes: list[str], arguments: argparse.Namespace
) -> tuple[NDArray[np.complex64], int]:
    """CSI (frames, antennas, subcarriers), and how many of its frames are of each UE one after another."""

    def arranged(values: NDArray[Any]) -> tuple[NDArray[np.complex64], int]:
        if arguments.shape is not None:
            values = values.reshape(arguments.shape)
        values, rest = taken(values, axes, dict(arguments.take))
        each = (
            values.shape[rest.index("frame")] if "frame" in rest and values.ndim > rest.index("frame") else 1
        )
        return frames(values, rest), each if "ue" in rest else 1

    names = arguments.csi.split(",") if arguments.csi not in capture.variables else [arguments.csi]
    if len(names) == 1:
        return _converted(capture, "--csi", arguments.csi, arranged)
    if len(names) != 2:
        raise SetupError(f"--csi {arguments.csi}: one variable, or two: real and imaginary part")
    imaginary = capture.read(names[1])

    def joined(real: NDArray[Any]) -> tuple[NDArray[np.complex64], int]:
        if real.shape != imaginary.shape or "c" in (real.dtype.kind, imaginary.dtype.kind):
            raise ValueError(f"is {real.dtype} {real.shape}, {names[1]} {imaginary.dtype} {imaginary.shape}")
        return arranged(real + 1j * imaginary)

    return _converted(capture, "--csi", names[0], joined)


def _tones(count: int, arguments: argparse.Namespace) -> list[int] | None:
    """Numbers of the subcarriers: as --tones says, or from the middle where --fftshift put them in order."""
    if arguments.tones not in ("used", "all"):
        tones = _numbers(arguments.tones)
        if len(tones) != count:
            raise SetupError(f"--tones {arguments.tones}: are {len(tones)} numbers for {count} subcarriers")
        return tones
    return list(range(-(count // 2), count - count // 2)) if arguments.fftshift else None


def _numbers(text: str) -> list[int]:
    """Numbers and ranges, ends included, as in -28:-1,1:28 or -28:28:2."""
    found: list[int] = []
    try:
        for word in text.split(","):
            first, *rest = (int(n) for n in word.split(":"))
            last, step = rest[0] if rest else first, rest[1] if len(rest) > 1 else 1
            if step < 1 or len(rest) > 2 or abs(last - first) > 1 << 20:
                raise ValueError
            found += range(first, last + 1, step)
    except ValueError:
        raise SetupError(f"--tones {text}: must be numbers and ranges, as in -28:-1,1:28") from None
    return found


def _converted(
    capture: Capture, option: str, name: str, convert: Callable[[NDArray[Any]], Converted]
) -> Converted:
    try:
        return convert(capture.read(name))
    except ValueError as error:
        raise SetupError(f"{option} {name}: {error}; {capture.path} has {capture.listing()}") from None
