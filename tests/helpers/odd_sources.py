"""Sources that misbehave, for nodes in tests; importable by a node's child processes."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.sources.base import EndOfSource, Source, SourceSettings

BLOCKS = 20
FRAMES = 10


class OddSettings(SourceSettings):
    """What goes wrong, and when."""

    type: Literal["odd"] = "odd"
    odd: Literal["open", "crash", "recv", "frames", "details"] = "open"
    """`open` fails, or `crash`es; `recv` raises half-way; odd `frames`: a wrong shape, a wrong number;
    `details` that raise, and numpy values before that."""


class Odd(Source):
    """Twenty blocks of ten frames, one of them odd."""

    Settings = OddSettings
    settings: OddSettings
    lossless = True

    def open(self) -> None:
        self._sent = 0
        if self.settings.odd == "open":
            raise SetupError("the radio is not plugged in: connect it to port 1")
        if self.settings.odd == "crash":
            raise ZeroDivisionError("a bug")

    def recv(self, timeout: float) -> CsiBlock | None:
        n, odd = self._sent, self.settings.odd
        if n == BLOCKS:
            raise EndOfSource
        self._sent += 1
        if n == BLOCKS // 2 and odd == "recv":
            raise RuntimeError("the radio was unplugged")
        if n == 5 and odd == "frames":
            return self._block(n, antennas=self.array.antennas + 1)
        if n == 10 and odd == "frames":
            return self._block(n + 1)
        return self._block(n)

    def details(self) -> dict[str, Any]:
        if self.settings.odd == "details" and self._sent > BLOCKS // 2:
            raise LookupError("a bug")
        return {"gain": np.float32(2.5), "levels": np.arange(3)}

    def _block(self, n: int, antennas: int | None = None) -> CsiBlock:
        shape = (FRAMES, antennas or self.array.antennas, self.array.subcarriers)
        ue = np.arange(FRAMES, dtype=np.uint64)
        return CsiBlock(
            self.array.name, n * FRAMES, ue, np.full(FRAMES, n, np.int64), np.ones(shape, np.complex64)
        )
