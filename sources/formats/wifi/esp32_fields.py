"""Which subcarriers the numbers of an ESP32 are (ESP-IDF programming guide, "Channel State Information").

A list holds up to three training fields one after another: of the legacy part (LLTF), of the 802.11n part
(HT-LTF), and its second one with STBC. Where the secondary channel is, and how long the list is, tell which.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

from chachart.sources.formats.wifi import tones
from chachart.sources.formats.wifi.log import Tones

NONE, ABOVE, BELOW = 0, 1, 2
"""Where the secondary channel of a 40 MHz channel is."""
_MIDDLE = {NONE: 0, ABOVE: -32, BELOW: 32}
"""Number of the subcarrier in the middle of a 20 MHz packet."""
_NAMES = ("csi", "csi_htltf", "csi_stbc_htltf")


class Field(NamedTuple):
    """A training field: its name, where its values are in the list, their subcarriers, ascending.

    `order` has for each subcarrier its place among the field's values in the list.
    """

    name: str
    start: int
    tones: Tones
    order: tuple[int, ...]


def _native(secondary: int, count: int) -> tuple[int, ...]:
    """Numbers of a field's values in the order of the list."""
    if count > 64 or secondary == NONE:
        half = -(-count // 2)
        return (*range(half), *range(half - count, 0))
    return tuple(range(count)) if secondary == BELOW else tuple(range(-count, 0))


_LENGTHS = {
    # secondary channel: {values in the list: values in each field}
    NONE: {64: (64,), 128: (64, 64), 192: (64, 64, 64)},
    BELOW: {64: (64,), 128: (64, 64), 190: (64, 63, 63), 192: (64, 128), 306: (64, 121, 121)},
    ABOVE: {64: (64,), 128: (64, 64), 188: (64, 62, 62), 192: (64, 128), 306: (64, 121, 121)},
}
_C5_HT20 = 57
"""Values of an HT20 packet of ESP32-C5 without LLTF: 0 to 28, -28 to -1."""


@cache
def fields(secondary: int, count: int) -> tuple[Field, ...]:
    """The fields of a list of `count` complex values; none where its subcarriers are not known.

    >>> [(f.name, len(f.order)) for f in fields(BELOW, 192)]
    [('csi', 64), ('csi_htltf', 128)]
    """
    if count == _C5_HT20:
        return (_field("csi", 0, (*range(29), *range(-28, 0)), tones.carrying("ht", 20), 0),)
    found: list[Field] = []
    start = 0
    for place, size in enumerate(_LENGTHS.get(secondary, {}).get(count, ())):
        legacy = place == 0
        used = tones.carrying("legacy" if legacy else "ht", 40 if size > 64 else 20)
        middle = 0 if size > 64 else _MIDDLE[secondary]
        found.append(_field(_NAMES[place], start, _native(secondary, size), used, middle))
        start += size
    return tuple(found)


def _field(name: str, start: int, native: tuple[int, ...], used: tuple[int, ...], middle: int) -> Field:
    order = sorted(range(len(native)), key=native.__getitem__)
    numbers = tuple(native[n] for n in order)
    there = set(numbers)
    carrying = tuple(n + middle for n in used if n + middle in there)
    return Field(name, start, Tones(numbers, carrying), tuple(order))


def carrier_hz(channel: int, secondary: int) -> float | None:
    """Middle of the channel, of both halves where it is 40 MHz wide; None for a number that is none."""
    hz = tones.channel_hz(channel)
    return None if hz is None else hz + {ABOVE: 1e7, BELOW: -1e7}.get(secondary, 0.0)
