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


_LENGTHS: dict[int | None, dict[int, tuple[int, ...]]] = {
    # secondary channel: {values in the list: values in each field}
    NONE: {64: (64,), 128: (64, 64), 192: (64, 64, 64)},
    BELOW: {64: (64,), 128: (64, 64), 190: (64, 63, 63), 192: (64, 128), 306: (64, 121, 121)},
    ABOVE: {64: (64,), 128: (64, 64), 188: (64, 62, 62), 192: (64, 128), 306: (64, 121, 121)},
}
_C5 = {
    # values in the list: (name, values, format, bandwidth) of each field
    53: (("csi", 53, "legacy", 20),),
    57: (("csi", 57, "ht", 20),),
    117: (("csi", 117, "ht", 40),),
    234: (("csi", 117, "ht", 40), ("csi_stbc_htltf", 117, "ht", 40)),
    245: (("csi", 245, "he", 20),),
}
"""ESP32-C5 and C61: without guards, from 0 up, then from the lowest to -1."""
_C6 = {
    64: ((("csi", 64, "legacy", 20),), (("csi", 64, "ht", 20),)),
    114: ((("csi", 57, "ht", 20), ("csi_stbc_htltf", 57, "ht", 20)),),
    128: ((("csi", 128, "ht", 40),), (("csi", 64, "ht", 20), ("csi_stbc_htltf", 64, "ht", 20))),
    256: ((("csi", 256, "he", 20),), (("csi", 128, "ht", 40), ("csi_stbc_htltf", 128, "ht", 40))),
}
"""The same for chips that do not tell the secondary channel: what is silent says which it is."""


@cache
def layouts(secondary: int | None, count: int) -> tuple[tuple[Field, ...], ...]:
    """What a list of `count` complex values can be, the likeliest first; none where nobody says it.

    `secondary` is None where the tool does not tell it, as for ESP32-C5 and C6. Some chips and tools write
    subcarriers in the order of the FFT, some ascending.

    >>> [(f.name, len(f.order)) for f in layouts(BELOW, 192)[0]]
    [('csi', 64), ('csi_htltf', 128)]
    >>> [f[0].tones.numbers[0] for f in layouts(None, 245)]
    [-122, -122]
    """
    told = (_C5[count],) if count in _C5 else _C6.get(count, ()) if secondary is None else ()
    orders = [(parts, shifted) for shifted in (False, True) for parts in told]
    found = [_without_secondary(parts, shifted) for parts, shifted in orders]
    if not found and (known := _with_secondary(secondary, count)):
        found = [known]
    return tuple(found)


def _without_secondary(parts: tuple[tuple[str, int, str, int], ...], ascending: bool) -> tuple[Field, ...]:
    fields: list[Field] = []
    start = 0
    for name, size, packet_format, mhz in parts:
        half = -(-size // 2)
        native = (*range(half), *range(half - size, 0))
        spacing = tones.HE_SPACING_HZ if packet_format == "he" else tones.SPACING_HZ
        used = tones.carrying(packet_format, mhz)
        fields.append(_field(name, start, tuple(sorted(native)) if ascending else native, used, 0, spacing))
        start += size
    return tuple(fields)


def _with_secondary(secondary: int | None, count: int) -> tuple[Field, ...]:
    found: list[Field] = []
    start = 0
    for place, size in enumerate(_LENGTHS.get(secondary, {}).get(count, ())):
        legacy = place == 0
        used = tones.carrying("legacy" if legacy else "ht", 40 if size > 64 else 20)
        middle = 0 if size > 64 else _MIDDLE[secondary or NONE]
        found.append(_field(_NAMES[place], start, _native(secondary or NONE, size), used, middle))
        start += size
    return tuple(found)


def _field(
    name: str,
    start: int,
    native: tuple[int, ...],
    used: tuple[int, ...],
    middle: int,
    spacing_hz: float = tones.SPACING_HZ,
) -> Field:
    order = sorted(range(len(native)), key=native.__getitem__)
    numbers = tuple(native[n] for n in order)
    there = set(numbers)
    carrying = tuple(n + middle for n in used if n + middle in there)
    return Field(name, start, Tones(numbers, carrying, (), spacing_hz), tuple(order))


def carrier_hz(channel: int, secondary: int | None, field: Tones) -> float | None:
    """Middle of the channel, of both halves where it is 40 MHz wide; None where nobody says it."""
    hz = tones.channel_hz(channel)
    used = field.used or (0,)
    wide = (used[-1] - used[0]) * (field.spacing_hz or 0) > 20e6
    if hz is None or (secondary is None and wide):
        return None
    return hz + {ABOVE: 1e7, BELOW: -1e7}.get(secondary or NONE, 0.0)
