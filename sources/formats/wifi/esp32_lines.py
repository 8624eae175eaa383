"""Lines of ESP32 boards: which columns they have, and the numbers of their lists.

A line is `CSI_DATA,...,[numbers]`, perhaps behind what a logger has put in front, and perhaps with columns
behind the list. A line of names says which column is which; without one the columns between the sender's
address and the list tell the tool. Lists are in brackets, with commas or spaces, in quotes or not, or base64
of signed bytes.
"""

from __future__ import annotations

import base64
import binascii
import itertools
import re
from collections import Counter
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MARK = b"CSI_DATA,"
_RADIO = (
    "rssi rate sig_mode mcs bandwidth smoothing not_sounding aggregation stbc fec_coding sgi noise_floor "
    "ampdu_cnt channel secondary_channel local_timestamp ant sig_len rx_state"
)
_C5 = "channel local_timestamp sig_len rx_state len first_word"
_DIALECTS = {
    len(words.split()): tuple(words.split())
    for words in (
        f"{_RADIO} len first_word",  # esp-csi
        f"{_RADIO} real_time_set real_timestamp len",  # ESP32-CSI-Tool
        f"{_RADIO} agc_gain fft_gain len first_word",  # console_test
        f"rssi rate noise_floor fft_gain agc_gain {_C5}",  # esp-csi, ESP32-C5 and C6
        f"rssi rate noise_floor {_C5}",  # the same, before gains were told
    )
}
"""Names of columns by how many stand between the address and the list."""
_ALIASES = {
    "channel_primary": "channel",
    "channel_secondary": "secondary_channel",
    "cwb": "bandwidth",
    "first_word_invalid": "first_word",
    "csi_data": "data",
    "csi": "data",
    "csi_raw": "data",
    "mac_address": "mac",
    "source_mac": "mac",
}
_MAC = re.compile(rb"(?:[0-9A-Fa-f]{1,2}[:-]){5}[0-9A-Fa-f]{1,2}\Z")
_BASE64 = re.compile(rb'"?([A-Za-z0-9+/]{8,}={0,2})"?\Z')
_IN_LISTS = b"0123456789-, \t"
_MOST = 4096
"""Numbers in a list; more are two lines that ran into each other."""
_LONGEST = 6
"""Digits of a number and its sign."""
_LARGEST = 1 << 14
_LISTS = 256
"""So many lists are parsed at once: what they need stays in the cache."""
_USUAL = 0.05
"""Without a line of names, columns are believed if at least so many of the lines have as many."""
_FEWEST = 8
"""So many lines make a habit."""


class Line(NamedTuple):
    """What stands in a line: the columns before the list by name, and the numbers of the list."""

    row: dict[str, bytes]
    numbers: NDArray[np.int16]


class _Raw(NamedTuple):
    words: list[bytes]
    text: bytes | None
    packed: bytes | None


def is_heading(line: bytes) -> bool:
    """Whether a line names columns."""
    return b"rssi" in line and b"mac" in line and "data" in _names(line)


def lines(data: bytes) -> list[Line | None]:
    """Every frame of a text, in order; None for one that is not whole."""
    headings: dict[int, tuple[str, ...]] = {}
    raws: list[_Raw | None] = []
    unmarked = False
    for text in data.split(b"\n"):
        if b"rssi" in text and is_heading(text):
            names = _names(text)
            start = names.index("type") if "type" in names else 0
            unmarked = "type" not in names
            columns = names[start : names.index("data")]
            headings[len(columns)] = columns
        elif MARK in text or b'CSI_DATA",' in text:
            pieces = text.replace(b'CSI_DATA",', MARK).split(MARK)
            raws += [_raw(MARK + piece) for piece in pieces[1:]]
        elif unmarked and b"[" in text:
            raws.append(_raw(text))
    columns_of = _columns(raws, headings)
    rows = [None if raw is None else columns_of.get(len(raw.words)) for raw in raws]
    return _parsed(raws, rows)


def _names(line: bytes) -> tuple[str, ...]:
    """Columns that a line names, in the words that are used here."""
    words = [word.strip().strip('"').lower() for word in line.decode("latin-1").strip().split(",")]
    names = [_ALIASES.get(word, word) for word in words]
    if "device_timestamp" in names:  # the other one is the computer's, then
        names = ["host_time" if name == "local_timestamp" else name for name in names]
        names[names.index("device_timestamp")] = "local_timestamp"
    return tuple(names)


def _raw(line: bytes) -> _Raw | None:
    """A line in its words and its list; None if it has no whole list."""
    before, bracket, rest = line.partition(b"[")
    if not bracket:
        words = [word.strip() for word in line.split(b",")]
        for place, word in enumerate(words[8:], 8):  # no column before is as long, and columns may follow
            match = _BASE64.match(word)
            if match and not word.isdigit():
                return _Raw(words[:place], None, match[1])
        return None
    inside, bracket, _ = rest.partition(b"]")
    if not bracket or inside.translate(None, _IN_LISTS):
        return None
    return _Raw(before.rstrip(b'" \t').split(b",")[:-1], inside, None)


def _columns(raws: list[_Raw | None], headings: dict[int, tuple[str, ...]]) -> dict[int, tuple[str, ...]]:
    """Names of columns by how many words stand before a list: as headings say, or as the tools have them."""
    counts = Counter(len(raw.words) for raw in raws if raw is not None)
    named = {count: names for count, names in headings.items() if counts[count]}
    if named:
        return named
    found: dict[int, tuple[str, ...]] = {}
    for raw in raws:
        if raw is None or len(raw.words) in found or counts[len(raw.words)] < _USUAL * counts.total():
            continue
        place = next((n for n, word in enumerate(raw.words) if _MAC.match(word.strip())), len(raw.words))
        tail = _DIALECTS.get(len(raw.words) - place - 1)
        if tail:
            found[len(raw.words)] = (*(f"column_{n}" for n in range(place)), "mac", *tail)
    return found


def _parsed(raws: list[_Raw | None], columns: list[tuple[str, ...] | None]) -> list[Line | None]:
    """The lines of which columns are known and all numbers make sense."""
    texts = [raw.text for raw in raws if raw is not None and raw.text is not None]
    parsed = itertools.chain.from_iterable(
        _integers(texts[first : first + _LISTS]) for first in range(0, len(texts), _LISTS)
    )
    found: list[Line | None] = []
    for raw, names in zip(raws, columns, strict=True):
        numbers = None
        if raw is not None:
            numbers = next(parsed) if raw.text is not None else _unpacked(raw.packed or b"")
        whole = numbers is not None and 0 < len(numbers) <= _MOST and not len(numbers) % 2
        if raw is None or names is None or numbers is None or not whole:
            found.append(None)
        else:
            found.append(Line(dict(zip(names, raw.words, strict=True)), numbers))
    return _complete(found)


def _integers(texts: list[bytes]) -> list[NDArray[np.int16] | None]:
    """The numbers of lists of digits, signs and separators, all at once; None for a list that has another."""
    if not texts:
        return []
    joined = np.frombuffer(b" " + b" ".join(texts) + b" " * _LONGEST, np.uint8)
    ends = np.cumsum([len(text) + 1 for text in texts])
    digit = joined - np.uint8(48)
    is_digit = digit < 10
    edges = np.flatnonzero(is_digit[1:] != is_digit[:-1]) + 1
    first, behind = edges[::2], edges[1::2]
    length = behind - first
    values = np.zeros(len(first), np.int32)
    for place in range(_LONGEST - 1):
        has = length > place
        if not has.any():
            break
        values += np.where(has, digit[np.maximum(behind - 1 - place, 0)], 0).astype(np.int32) * 10**place
    minus = joined == ord("-")
    negative = minus[first - 1]
    np.negative(values, out=values, where=negative)
    odd = first[(length >= _LONGEST) | (np.abs(values) > _LARGEST)]
    signs = np.flatnonzero(minus)
    stray = signs[~is_digit[signs + 1] | is_digit[signs - 1] | minus[signs - 1]]
    bad = set(np.searchsorted(ends, np.concatenate([odd, stray]), side="left").tolist())
    parts = np.split(values.astype(np.int16), np.searchsorted(first, ends[:-1]))
    return [None if n in bad else part for n, part in enumerate(parts)]


def _unpacked(text: bytes) -> NDArray[np.int16] | None:
    try:
        return np.frombuffer(base64.b64decode(text, validate=True), np.int8).astype(np.int16)
    except (binascii.Error, ValueError):
        return None


def _complete(found: list[Line | None]) -> list[Line | None]:
    """`found` without lines whose list has another length than they say.

    The tools may print the legacy field only; numbers of 12 bits take two bytes; and a file of which most
    lines say one number and have another one has been cut to some subcarriers by its owner.
    """
    told: list[tuple[int, int]] = []
    for line in found:
        count = 0 if line is None else len(line.numbers)
        told.append((count, -1 if line is None else number(line.row, "len", -1)))
    pairs = Counter(pair for pair in told if pair[0])
    habit = pairs.most_common(1)[0] if pairs else ((0, 0), 0)
    usual = habit[0] if habit[1] >= max(_FEWEST, 0.5 * pairs.total()) else (0, 0)
    return [
        line
        if says in (0, count, 2 * count) or (count == 128 and says > 128) or (count, says) == usual
        else None
        for line, (count, says) in zip(found, told, strict=True)
    ]


def number(row: dict[str, bytes], name: str, otherwise: int | None = None) -> int:
    """A column as a number, 0 where there is none.

    Raises
    ------
    ValueError
        If it is no whole number, and nothing is to be taken instead.
    """
    word = row.get(name, b"0")
    try:
        return int(word)
    except ValueError:
        pass
    try:
        value = float(word)
        if value.is_integer() and abs(value) < 1e15:
            return int(value)
    except ValueError:
        pass
    if otherwise is None:
        raise ValueError(f"{name} is no number")
    return otherwise


@lru_cache(4096)
def address(text: bytes) -> int | None:
    """A sender's address as a number; None where it is none."""
    word = text.strip().strip(b'"')
    if not _MAC.match(word):
        return None
    return int.from_bytes(bytes(int(part, 16) for part in re.split(rb"[:-]", word)), "big")
