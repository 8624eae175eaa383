"""Numbers of subcarriers by the IEEE 802.11 standards, and the frequencies of channels."""

from __future__ import annotations

from functools import cache

from chachart.sources.formats.wifi.log import Tones

SPACING_HZ = 312_500.0
HE_SPACING_HZ = 78_125.0

_PILOTS_20 = (7, 21)
_PILOTS = {
    # (format, bandwidth): pilots above the middle; those below mirror them.
    ("legacy", 20): _PILOTS_20,
    ("ht", 20): _PILOTS_20,
    ("ht", 40): (11, 25, 53),
    ("vht", 80): (11, 39, 75, 103),
    ("vht", 160): (25, 53, 89, 117, 139, 167, 203, 231),
    ("he", 20): (22, 48, 90, 116),
    ("he", 40): (10, 36, 78, 104, 144, 170, 212, 238),
    ("he", 80): (24, 92, 158, 226, 266, 334, 400, 468),
    ("he", 160): (44, 112, 178, 246, 286, 354, 420, 488, 536, 604, 670, 738, 778, 846, 912, 980),
}
_CARRYING = {
    # (format, bandwidth): spans of subcarriers above the middle; those below mirror them.
    ("legacy", 20): ((1, 26),),
    ("ht", 20): ((1, 28),),
    ("ht", 40): ((2, 58),),
    ("vht", 80): ((2, 122),),
    ("vht", 160): ((6, 126), (130, 250)),
    ("he", 20): ((2, 122),),
    ("he", 40): ((3, 244),),
    ("he", 80): ((3, 500),),
    ("he", 160): ((12, 509), (515, 1012)),
}


@cache
def carrying(packet_format: str, bandwidth_mhz: int) -> tuple[int, ...]:
    """Numbers of the subcarriers that carry a signal; empty for a format that is not known.

    >>> len(carrying("ht", 20)), len(carrying("vht", 80)), len(carrying("he", 160))
    (56, 242, 1992)
    """
    above = [
        n for low, high in _CARRYING.get(_row(packet_format, bandwidth_mhz), ()) for n in range(low, high + 1)
    ]
    return (*(-n for n in reversed(above)), *above)


@cache
def pilots(packet_format: str, bandwidth_mhz: int) -> tuple[int, ...]:
    """Numbers of the pilots."""
    above = _PILOTS.get(_row(packet_format, bandwidth_mhz), ())
    return (*(-n for n in reversed(above)), *above)


def _row(packet_format: str, bandwidth_mhz: int) -> tuple[str, int]:
    if packet_format == "vht" and bandwidth_mhz in (20, 40):
        return "ht", bandwidth_mhz
    return packet_format, bandwidth_mhz


@cache
def standard(packet_format: str, bandwidth_mhz: int, count: int, weak_pilots: bool) -> Tones:
    """The subcarriers of a capture that has just those with a signal; unknown where `count` differs."""
    spacing = HE_SPACING_HZ if packet_format in ("he", "eht") else SPACING_HZ
    numbers = carrying(packet_format, bandwidth_mhz)
    if len(numbers) != count:
        return Tones(None, spacing_hz=spacing)
    weak = pilots(packet_format, bandwidth_mhz) if weak_pilots else ()
    return Tones(numbers, numbers, weak, spacing)


@cache
def intel5300(bandwidth_mhz: int) -> Tones:
    """The 30 groups of the Intel 5300 (IEEE 802.11n, table 7-25f, Ng = 2 at 20 MHz and 4 at 40 MHz)."""
    if bandwidth_mhz == 40:
        numbers = tuple(range(-58, 59, 4))
    else:
        numbers = (*range(-28, -1, 2), -1, *range(1, 28, 2), 28)
    return Tones(numbers, numbers)


def channel_hz(channel: int, band_ghz: int | None = None) -> float | None:
    """Middle of a channel; None for a number that is none. The band is told by the number if not given.

    >>> channel_hz(6), channel_hz(14), channel_hz(42)
    (2437000000.0, 2484000000.0, 5210000000.0)
    """
    if band_ghz == 6:
        return 5.95e9 + channel * 5e6
    if band_ghz != 5 and 1 <= channel <= 14:
        return 2.484e9 if channel == 14 else 2.407e9 + channel * 5e6
    return 5e9 + channel * 5e6 if 14 < channel <= 200 and band_ghz != 2 else None
