"""The published numbers: trustworthiness, continuity and seconds of eleven pairs of estimators.

Jiang and Ayanoglu, "Alternative channel charting techniques in cellular wireless communications",
arXiv:2412.13217: 2048 UEs, 32 antennas, 32 subcarriers over 312.5 kHz in all, 0 dB, K = 102. The seconds are
those of the line-of-sight channel, for the estimates of all 2048 UEs.
"""

from __future__ import annotations

from typing import Final, NamedTuple

CITATION: Final = (
    "Jiang and Ayanoglu, “Alternative channel charting techniques in cellular wireless communications”, "
    "arXiv:2412.13217"
)
SNR_DB: Final = 0.0
UES: Final = 2048
BANDWIDTH_HZ: Final = 312.5e3

Pair = tuple[str, str]
"""Names of the theta and of the rho method."""

PAIRS: Final[tuple[Pair, ...]] = (
    ("bartlett", "bartlett"),
    ("music", "music"),
    ("bartlett", "lr"),
    ("bartlett", "isq"),
    ("bartlett", "music"),
    ("mvdr", "lr"),
    ("mvdr", "isq"),
    ("mvdr", "music"),
    ("minnorm", "lr"),
    ("minnorm", "isq"),
    ("minnorm", "music"),
)


class Published(NamedTuple):
    """One pair's row: TW and CT on a channel, seconds where they were published."""

    tw: float
    ct: float
    seconds: float | None


_TW = {
    "los": (0.9998, 0.9998, 0.9930, 0.9885, 0.9998, 0.9796, 0.9753, 0.9864, 0.9330, 0.9885, 0.9998),
    "qlos": (0.9974, 0.9975, 0.9203, 0.9205, 0.9975, 0.8882, 0.8889, 0.9607, 0.9192, 0.9194, 0.9960),
    "qnlos": (0.9871, 0.9854, 0.9322, 0.9324, 0.9857, 0.8887, 0.8898, 0.9362, 0.9234, 0.9238, 0.9769),
}
_CT = {
    "los": (0.9998, 0.9998, 0.9968, 0.9940, 0.9998, 0.9816, 0.9761, 0.9864, 0.9968, 0.9940, 0.9998),
    "qlos": (0.9988, 0.9989, 0.9622, 0.9483, 0.9989, 0.9158, 0.9068, 0.9601, 0.9606, 0.9468, 0.9974),
    "qnlos": (0.9892, 0.9867, 0.9682, 0.9631, 0.9872, 0.9082, 0.9067, 0.9354, 0.9552, 0.9513, 0.9773),
}
_SECONDS = (1.1203, 20.6577, 0.4212, 0.4154, 16.0008, 6.4927, 6.3431, 21.0445, 13.5298, 13.1709, 28.1667)


def published(channel: str, pair: Pair) -> Published | None:
    """What was published for a pair on a channel; None if nothing was."""
    if pair not in PAIRS or channel not in _TW:
        return None
    n = PAIRS.index(pair)
    return Published(_TW[channel][n], _CT[channel][n], _SECONDS[n] if channel == "los" else None)
