"""Inputs that are almost right: bits and words changed, pieces cut, doubled, zeroed, inserted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

HEAD_BYTES = 256
"""Half of the mutations hit an input's beginning, where most of its structure stands."""
MOST, DRAWS_EACH = 4, 6
_BATCH = 1000
_TELLING = (0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_NOISE = np.random.default_rng(20260101).bytes(1 << 16)


def mutations(samples: Sequence[bytes], seed: int, first: int, count: int) -> Iterator[bytes]:
    """Inputs `first` to `first + count` of a seed, one of the samples each."""
    end = first + count
    for begin in range(first - first % _BATCH, end, _BATCH):
        draws = np.random.default_rng([seed, begin]).random((_BATCH, 1 + MOST * DRAWS_EACH))
        for n in range(max(begin, first), min(begin + _BATCH, end)):
            yield _mutated(samples[n % len(samples)], draws[n - begin].tolist())


def _mutated(data: bytes, drawn: Sequence[float]) -> bytes:
    """As many numbers from 0 to 1 as there may be mutations decide."""
    found = bytearray(data)
    for k in range(1, 1 + DRAWS_EACH * (1 + int(drawn[0] * MOST)), DRAWS_EACH):
        size = len(found)
        if not size:
            break
        head, where, how_long, kind, value, order = drawn[k : k + DRAWS_EACH]
        at = int(where * (min(size, HEAD_BYTES) if head < 0.5 else size))
        length = min(size - at, 1 + int(how_long * 64))
        match int(kind * 8):
            case 0:
                found[at] ^= 1 << int(value * 8)
            case 1:
                found[at] = int(value * 256)
            case 2:
                width = 1 << int(how_long * 4)
                word = _TELLING[int(value * len(_TELLING))] & ((1 << 8 * width) - 1)
                found[at : at + width] = word.to_bytes(width, "little" if order < 0.5 else "big")
            case 3:
                del found[at:]
            case 4:
                del found[at : at + length]
            case 5:
                found[at:at] = found[at : at + length]
            case 6:
                found[at : at + length] = bytes(length)
            case 7:
                begin = int(value * (len(_NOISE) - 64))
                found[at:at] = _NOISE[begin : begin + length]
    return bytes(found)
