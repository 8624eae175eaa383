"""Text of ESP32 boards: one line a frame, `CSI_DATA,...,[imaginary real imaginary real ...]`.

Dialects of esp-csi (25 columns; 15 for ESP32-C5 and C6; 30 of console_test, whose list can be base64) and of
the ESP32-CSI-Tool (26 columns). A line `type,...` names the columns; else their number tells. Other lines are
log messages and are passed over; a line that is not whole is left out.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.base import HEAD_BYTES
from chachart.sources.formats.clock import unwrapped
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.esp32_fields import carrier_hz, fields
from chachart.sources.formats.wifi.log import Group, Kind, Log, Tones

NAME = "ESP32 .csv"

_MARK = b"CSI_DATA,"
_HEADINGS = b"type,"
_N = "mac rssi rate sig_mode mcs bandwidth smoothing not_sounding aggregation stbc fec_coding sgi noise_floor"
_RADIO = f"{_N} ampdu_cnt channel secondary_channel local_timestamp ant sig_len rx_state"
_DIALECTS = {
    len(words.split()) - 1: tuple(words.split())
    for words in (
        f"type id {_RADIO} len first_word data",
        f"type role {_RADIO} real_time_set real_timestamp len data",
        "type seq mac rssi rate noise_floor fft_gain agc_gain channel local_timestamp sig_len rx_state len "
        "first_word data",
        f"type seq timestamp target_seq target {_RADIO} agc_gain fft_gain len first_word data",
    )
}
"""Names of columns by how many stand before the list."""
_ALIASES = {
    "channel_primary": "channel",
    "channel_secondary": "secondary_channel",
    "cwb": "bandwidth",
    "first_word_invalid": "first_word",
    "CSI_DATA": "data",
}
_LIST = re.compile(rb'"?\[([-0-9, ]*)\]"?\s*\Z')
_BASE64 = re.compile(rb'"?([A-Za-z0-9+/]+={0,2})"?\s*\Z')
_MAC = re.compile(rb"(?:[0-9A-Fa-f]{2}:){5}[0-9A-Fa-f]{2}\Z")
_MOST = 4096
"""Numbers in a list; more are two lines that ran into each other."""
_FIRST_WORD = 2
"""Complex values in the first word."""


class _Line(NamedTuple):
    values: NDArray[np.int16]
    mac: int
    clock: int
    rssi: int
    noise: int
    agc: int
    fft: int
    channel: int
    secondary: int
    invalid: bool
    has_gains: bool


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is or may be."""
    if head.startswith(_MARK) or b"\n" + _MARK in head:
        return None
    text = b"\0" not in head and all(octet >= 0x20 or octet in b"\t\r\n\x1b\x07\x08\x0c" for octet in head)
    if len(head) >= HEAD_BYTES and text:
        return None  # a log whose first frame comes later; `read` looks through all of it
    return "no line begins with CSI_DATA"


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
    found: list[_Line] = []
    number: list[int] = []
    count = broken = 0
    dialects = dict(_DIALECTS)
    for text in data.tobytes().split(b"\n"):
        if text.startswith(_HEADINGS):
            columns = tuple(_ALIASES.get(name, name) for name in text.decode("latin-1").strip().split(","))
            if "data" in columns:
                dialects[columns.index("data")] = columns
        elif text.startswith(_MARK):
            parsed = _parsed(text, dialects)
            if parsed is None:
                broken += 1
            else:
                found.append(parsed)
                number.append(count)
            count += 1
    left_out = Counter({"broken line": broken} if broken else {})
    clock = unwrapped(np.array([line.clock for line in found], np.int64), bits=32) * 1000 if found else None
    parts: dict[tuple[int, int, int], list[int]] = {}
    for row, line in enumerate(found):
        # The numbers of the legacy field are the same whatever follows it.
        known = fields(line.secondary, len(line.values) // 2)
        size = len(known[0].order) if known else len(line.values) // 2
        parts.setdefault((size, line.secondary, line.channel), []).append(row)
    groups = [
        _group([found[row] for row in rows], np.array(number)[rows], clock[rows])
        for rows in parts.values()
        if clock is not None
    ]
    return Log(
        groups,
        left_out,
        "local_timestamp, 1 MHz, 32 bits",
        has_senders=True,
        order=("shape", "tones", "channel"),
    )


def _group(lines: list[_Line], number: NDArray[np.int64], time: NDArray[np.int64]) -> Group:
    first = lines[0]
    lists = [fields(line.secondary, len(line.values) // 2) for line in lines]
    known = lists[0]
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
        carrier_hz=carrier_hz(first.channel, first.secondary),
        channel=first.channel,
    )
    more = {}
    if all(found == known for found in lists):
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


def _parsed(line: bytes, dialects: dict[int, tuple[str, ...]]) -> _Line | None:
    """What a line says; None if it is not whole."""
    before, bracket, rest = line.partition(b"[")
    if bracket:
        words = before.rstrip(b'"').split(b",")[:-1]
        match = _LIST.match(b"[" + rest)
        numbers = match and match[1].replace(b",", b" ").split()
    else:
        *words, last = line.split(b",")
        match = _BASE64.match(last)
        numbers = match and _unpacked(match[1])
    columns = dialects.get(len(words))
    if not numbers or columns is None or len(numbers) % 2 or len(numbers) > _MOST:
        return None
    try:
        values = np.array([int(word) for word in numbers], np.int64)
        row = dict(zip(columns, words, strict=False))
        told = _number(row, "len")
    except (ValueError, OverflowError):
        return None
    if np.abs(values).max() > 1 << 14 or not _complete(len(values), told):
        return None
    return _facts(row, values.astype(np.int16))


def _facts(row: dict[str, bytes], values: NDArray[np.int16]) -> _Line | None:
    address = row.get("mac", b"").strip()
    if not _MAC.match(address):
        return None
    try:
        line = _Line(
            values,
            int(address.replace(b":", b""), 16),
            _number(row, "local_timestamp"),
            _number(row, "rssi"),
            _number(row, "noise_floor"),
            _number(row, "agc_gain"),
            _number(row, "fft_gain"),
            _number(row, "channel"),
            _number(row, "secondary_channel"),
            _number(row, "first_word") != 0,
            "agc_gain" in row and "fft_gain" in row,
        )
    except ValueError:
        return None
    small = all(abs(number) < 1 << 15 for number in (line.rssi, line.noise, line.agc, line.fft))
    return line if small and 0 <= line.clock < 1 << 32 and line.secondary in (0, 1, 2) else None


def _complete(count: int, told: int) -> bool:
    """Whether a list of so many numbers is whole where its line says `told`.

    The tools may print the legacy field only; numbers of 12 bits take two bytes.
    """
    return told in (0, count, 2 * count) or (count == 128 and told > 128)


def _number(row: dict[str, bytes], name: str) -> int:
    """A column as a number, 0 where there is none."""
    word = row.get(name, b"0").strip()
    if not re.fullmatch(rb"-?[0-9]{1,12}", word):
        raise ValueError(f"{name} is no number")
    return int(word)


def _unpacked(text: bytes) -> list[int] | None:
    try:
        numbers: list[int] = np.frombuffer(base64.b64decode(text, validate=True), np.int8).tolist()
    except (binascii.Error, ValueError):
        return None
    return numbers
