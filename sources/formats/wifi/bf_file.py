"""MATLAB files of cells or structs with CSI of the Intel 5300, as read_bf_file of its tool returns them.

Each frame is a struct with `csi` of (streams, antennas, 30), `timestamp_low`, `Nrx`, `rssi_a` ... `rssi_c`,
`noise`, `agc`, `perm`, `rate`. Where the permutation makes sense the tool has put the antennas in the order
of the connectors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.clock import unwrapped
from chachart.sources.formats.matlab_elements import elements, matrices, numbers, order_of
from chachart.sources.formats.wifi import tones
from chachart.sources.formats.wifi.log import Group, Kind, Log

CELLS = "MATLAB .mat of read_bf_file"

_CELL, _STRUCT = 1, 2
_GROUPS = 30
_HT40 = 0x800
_MOST = 1e6
"""CSI of 8 bits is far smaller."""
_MOST_FIELDS = 64
_DEEPEST = 8
"""Cells and structs within each other."""

Frame = dict[str, NDArray[Any]]


def frames_in(data: bytes) -> bool:
    """Whether a MATLAB file holds frames, in cells or structs.

    Raises
    ------
    ValueError
        Where a length does not fit.
    """
    return any(is_frame(frame) for frame in _frames(data))


def is_frame(frame: Frame) -> bool:
    """Whether a struct is a frame, as read_bf_file returns it."""
    return "csi" in frame and _parsed(frame) is not None


def read_cells(data: NDArray[np.uint8]) -> Log:
    """The frames of a file, bytes (N,).

    Raises
    ------
    ValueError
        Where a length does not fit.
    """
    return log_of(_frames(data.tobytes()))


def log_of(frames: Iterable[Frame]) -> Log:
    """The frames of structs; those without a field `csi` are something else."""
    found: list[tuple[Kind, NDArray[Any], Frame]] = []
    number: list[int] = []
    count = broken = 0
    for frame in frames:
        if "csi" not in frame:
            continue
        parsed = _parsed(frame)
        if parsed is None:
            broken += 1
        else:
            found.append((*parsed, frame))
            number.append(count)
        count += 1
    clock = np.array([_number(frame, "timestamp_low") for _, _, frame in found])
    times = unwrapped(clock.astype(np.int64) & 0xFFFFFFFF, bits=32) * 1000 if len(clock) else clock
    groups = []
    for kind in dict.fromkeys(kind for kind, _, _ in found):
        rows = [n for n, (other, _, _) in enumerate(found) if other == kind]
        csi = np.stack([found[n][1] for n in rows]).astype(np.complex64)
        columns = _columns([found[n][2] for n in rows]) | {"time": times[rows].astype(np.int64)}
        groups.append(Group(kind, np.array(number, np.int64)[rows], csi, columns))
    left_out = Counter({"broken record": broken} if broken else {})
    return Log(groups, left_out, "1 MHz counter of 32 bits")


def _columns(frames: list[Frame]) -> dict[str, NDArray[Any]]:
    rssi = np.array([[_number(f, f"rssi_{letter}") for letter in "abc"] for f in frames])
    agc = np.array([_number(f, "agc") for f in frames])
    power = np.where(rssi > 0, 10 ** (np.minimum(rssi, 127) / 10), 0.0).sum(axis=1)
    with np.errstate(divide="ignore"):
        total = 10 * np.log10(power) - 44 - agc
    return {
        "ue": np.zeros(len(frames), np.uint64),
        "rssi": rssi.astype(np.int16),
        "agc": agc.astype(np.int16),
        "noise": np.array([_number(f, "noise") for f in frames]).astype(np.int16),
        "rssi_dbm": np.where(power > 0, total, np.nan).astype(np.float32),
    }


def _parsed(frame: Frame) -> tuple[Kind, NDArray[Any]] | None:
    """Kind and CSI (antennas, streams, 30) of a frame; None if it is not whole."""
    csi = frame["csi"]
    if csi.ndim == 2 and csi.shape[1] == _GROUPS:
        csi = csi[None]
    if csi.ndim != 3 or csi.shape[2] != _GROUPS or 0 in csi.shape or not np.abs(csi).max() < _MOST:
        return None
    sent, antennas, _ = csi.shape
    if antennas > 3 or sent > 4:
        return None
    mhz = 40 if int(_number(frame, "rate")) & _HT40 else 20
    chains = [
        int(n) for n in np.ravel(frame.get("perm", np.arange(1, 4)))[:antennas].tolist() if n in (1, 2, 3)
    ]
    if sorted(chains) == list(range(1, antennas + 1)) or len(chains) < antennas:
        names, order = tuple("ABC"[:antennas]), list(range(antennas))
    else:
        order = sorted(range(antennas), key=lambda n: chains[n])
        names = tuple("ABC"[chains[n] - 1] for n in order)
    kind = Kind(antennas, sent, _GROUPS, tones.intel5300(mhz), names, bandwidth_hz=mhz * 1e6)
    return kind, csi.transpose(1, 0, 2)[order]


def _number(frame: Frame, name: str) -> float:
    """A field's first number, 0 where there is none that makes sense: the clock has 32 bits, others fewer."""
    values = np.ravel(frame.get(name, np.zeros(1)))
    value = float(values[0].real) if len(values) else 0.0
    return value if abs(value) < (1 << 32 if name == "timestamp_low" else 1 << 15) else 0.0


def _frames(data: bytes) -> Iterator[Frame]:
    """The structs of a file, those within cells and other structs included."""
    order = order_of(data)
    for element in matrices(data):
        yield from _structs_in(element, order, 0)


def _structs_in(element: memoryview, order: str, depth: int) -> Iterator[Frame]:
    """The structs in a matrix element.

    Raises
    ------
    ValueError
        Where a length does not fit.
    """
    parts = list(elements(element, order))
    if not parts:
        return  # an empty cell
    if len(parts[0][1]) != 8:
        raise ValueError("an array without flags")
    kind = int(np.frombuffer(parts[0][1], f"{order}u4")[0]) & 0xFF
    if depth > _DEEPEST:
        return
    if kind == _STRUCT:
        yield from _structs(parts, order, depth)
    elif kind == _CELL:
        for _, cell in parts[3:]:
            yield from _structs_in(cell, order, depth + 1)


def _structs(parts: list[tuple[int, memoryview]], order: str, depth: int) -> Iterator[Frame]:
    """The elements of a struct array: flags, dimensions, name, length of names, names, then all fields."""
    if len(parts) < 5 or len(parts[3][1]) != 4:
        raise ValueError("a struct without names of fields")
    width = int(np.frombuffer(parts[3][1], f"{order}i4")[0])
    text = bytes(parts[4][1])
    if width < 1 or len(text) % width or not 0 < len(text) // width <= _MOST_FIELDS:
        raise ValueError(f"names of fields in {len(text)} bytes, {width} each")
    names = [text[at : at + width].split(b"\0")[0].decode("latin-1") for at in range(0, len(text), width)]
    fields = parts[5:]
    for first in range(0, len(fields) - len(names) + 1, len(names)):
        some = fields[first : first + len(names)]
        values = {name: numbers(data, order) for name, (_, data) in zip(names, some, strict=True)}
        if values.get("csi") is None:
            for name, (_, data) in zip(names, some, strict=True):
                if values[name] is None:
                    yield from _structs_in(data, order, depth + 1)
        yield {name: value for name, value in values.items() if value is not None}
