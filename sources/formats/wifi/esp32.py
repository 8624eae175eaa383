"""Text of ESP32 boards: one line a frame, `CSI_DATA,...,[imaginary real imaginary real ...]`.

What esp-csi (also for ESP32-C5 and C6, and its console_test), the ESP32-CSI-Tool and their descendants write;
see `esp32_lines`. Other lines are log messages and are passed over; a line that is not whole is left out.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.base import HEAD_BYTES
from chachart.sources.formats.clock import unwrapped
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.esp32_fields import Field, carrier_hz, layouts
from chachart.sources.formats.wifi.esp32_lines import MARK, Line, address, is_heading, lines, number
from chachart.sources.formats.wifi.log import Group, Kind, Log, Tones

NAME = "ESP32 .csv"

_FIRST_WORD = 2
"""Complex values in the first word."""
_CLEAR = 0.25
"""Another order of subcarriers is believed where so little power is left on those that carry nothing."""


class _Frame(NamedTuple):
    values: NDArray[np.int16]
    mac: int
    clock: int
    rssi: int
    noise: int
    agc: int
    fft: int
    channel: int
    secondary: int | None
    invalid: bool
    has_gains: bool


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is or may be."""
    first, _, _ = head.partition(b"\n")
    if MARK in head or is_heading(first):
        return None
    text = b"\0" not in head and all(octet >= 0x20 or octet in b"\t\r\n\x1b\x07\x08\x0c" for octet in head)
    if len(head) >= HEAD_BYTES and text:
        return None  # a log whose first frame comes later; `read` looks through all of it
    return "no line has CSI_DATA"


def open_capture(path: Path) -> WifiCapture:
    """The CSI of a log.

    Raises
    ------
    SetupError
        If the log cannot be read or has no CSI.
    """
    return WifiCapture(path, NAME, read, ("ue", "subcarrier"))


def read(data: NDArray[np.uint8]) -> Log:
    """The frames of whole lines, bytes (N,) of a file or as a serial port gave them."""
    frames = [None if line is None else _frame(line) for line in lines(data.tobytes())]
    found = [(n, frame) for n, frame in enumerate(frames) if frame is not None]
    broken = len(frames) - len(found)
    left_out = Counter({"broken line": broken} if broken else {})
    parts: dict[tuple[int, int | None, int], list[int]] = {}
    for row, (_, frame) in enumerate(found):
        # The numbers of the legacy field are the same whatever follows it.
        count = len(frame.values) // 2
        known = layouts(frame.secondary, count)
        size = len(known[0][0].order) if len(known) == 1 else count
        parts.setdefault((size, frame.secondary, frame.channel), []).append(row)
    groups = []
    if found:
        clock = unwrapped(np.array([frame.clock for _, frame in found], np.int64), bits=32) * 1000
        groups = [
            _group([found[n][1] for n in rows], np.array([found[n][0] for n in rows]), clock[rows])
            for rows in parts.values()
        ]
    return Log(
        groups,
        left_out,
        "local_timestamp, 1 MHz, 32 bits",
        has_senders=True,
        order=("shape", "tones", "channel"),
    )


def _group(lines: list[_Frame], number: NDArray[np.int64], time: NDArray[np.int64]) -> Group:
    first = lines[0]
    known = _layout(lines)
    size = len(known[0].order) if known else len(first.values) // 2
    values = np.stack([line.values[: 2 * size] for line in lines]).reshape(len(lines), size, 2)
    order = known[0].order if known else tuple(range(size))
    invalid = np.zeros((len(lines), size), bool)
    invalid[[line.invalid for line in lines], :_FIRST_WORD] = True
    invalid = invalid[:, order]
    of_field = known[0].tones if known else Tones(None)
    spoilt = np.flatnonzero(invalid.any(axis=0)).tolist()
    bad = {of_field.numbers[n] for n in spoilt} if of_field.numbers else set[int]()
    of_field = of_field._replace(weak=tuple(n for n in of_field.used if n in bad))
    columns: dict[str, NDArray[Any]] = {
        "time": time,
        "ue": np.array([line.mac for line in lines], np.uint64),
        "rssi": np.array([[line.rssi] for line in lines], np.int16),
        "rssi_dbm": np.array([line.rssi for line in lines], np.float32),
        "noise": np.array([line.noise for line in lines], np.int16),
    }
    if all(line.has_gains for line in lines):
        columns["agc"] = np.array([line.agc for line in lines], np.int16)
        columns["fft"] = np.array([line.fft for line in lines], np.int16)
    if invalid.any():
        columns["invalid"] = invalid
    kind = Kind(
        1,
        1,
        size,
        of_field,
        carrier_hz=carrier_hz(first.channel, first.secondary, of_field),
        channel=first.channel,
    )
    more = {}
    if all(len(line.values) == len(first.values) for line in lines):
        for field in known[1:]:
            pairs = np.stack([line.values for line in lines]).reshape(len(lines), -1, 2)
            picked = pairs[:, field.start : field.start + len(field.order)][:, list(field.order)]
            more[field.name] = field.tones, _complex(picked)
    return Group(kind, number, _complex(values[:, list(order)]), columns, more)


def _complex(pairs: NDArray[np.int16]) -> NDArray[np.complex64]:
    """complex64 (F, 1, 1, N) of imaginary and real parts (F, N, 2)."""
    values = np.empty((len(pairs), 1, 1, pairs.shape[1]), np.complex64)
    values.real[:, 0, 0], values.imag[:, 0, 0] = pairs[..., 1], pairs[..., 0]
    return values


def _layout(frames: list[_Frame]) -> tuple[Field, ...]:
    """The fields of these frames' lists: what the tools say, unless what carries no signal contradicts it."""
    first = frames[0]
    usual, *others = layouts(first.secondary, len(first.values) // 2) or ((),)
    same = [frame.values for frame in frames if len(frame.values) == len(first.values)]
    if not others:
        return usual
    pairs = np.stack(same).reshape(len(same), -1, 2).astype(np.float64)
    power = np.square(pairs).sum(axis=(0, 2))
    left = [_on_silent(power, layout) for layout in (usual, *others)]
    best = int(np.argmin(left))
    return (usual, *others)[best] if left[best] < _CLEAR * left[0] else usual


def _on_silent(power: NDArray[np.float64], layout: tuple[Field, ...]) -> float:
    """Mean power (N,) of the list on subcarriers that carry nothing, against those that carry a signal."""
    silent: list[int] = []
    carrying: list[int] = []
    for field in layout:
        for tone, place in zip(field.tones.numbers or (), field.order, strict=True):
            (carrying if tone in field.tones.used else silent).append(field.start + place)
    signal = float(power[carrying].mean())
    return float(power[silent].mean()) / signal if signal > 0 else 1.0


def _frame(line: Line) -> _Frame | None:
    """What a line says; None if it makes no sense."""
    row = line.row
    sender = address(row.get("mac", b""))
    if sender is None:
        return None
    try:
        frame = _Frame(
            line.numbers,
            sender,
            number(row, "local_timestamp"),
            number(row, "rssi"),
            number(row, "noise_floor"),
            number(row, "agc_gain"),
            number(row, "fft_gain"),
            number(row, "channel"),
            number(row, "secondary_channel") if "secondary_channel" in row else None,
            number(row, "first_word") != 0,
            "agc_gain" in row and "fft_gain" in row,
        )
        told = number(row, "first_word")
    except ValueError:
        return None
    small = all(abs(value) < 1 << 15 for value in (frame.rssi, frame.noise, frame.agc, frame.fft))
    clock = frame.clock + (
        1 << 32 if frame.clock < 0 else 0
    )  # some print the unsigned clock as a signed number
    good = small and told in (0, 1) and 0 <= clock < 1 << 32 and frame.secondary in (None, 0, 1, 2)
    return frame._replace(clock=clock) if good and abs(frame.channel) < 1 << 15 else None
