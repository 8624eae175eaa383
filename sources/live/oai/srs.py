"""From channel estimates of single antennas to frames: the tones in use, all antennas of one sounding."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.counters import Counters
from chachart.sources.live.device import CodecError
from chachart.sources.live.oai.tracer import Value

EVENTS = ("GNB_PHY_UL_FREQ_CHANNEL_ESTIMATE", "GNB_PHY_SRS_LS_ESTIMATE")
"""Events with an estimate by tone; the first that a gNB knows is taken."""
KEPT_SOUNDINGS = 64


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What one antenna heard of one sounding: by tone, ascending, zeros where nothing was sent."""

    rnti: int
    frame: int
    antenna: int
    port: int
    tones: NDArray[np.complex64]


def estimate(values: dict[str, Value], symbols: int) -> Estimate:
    """An event's arguments as an estimate.

    Parameters
    ----------
    values
        `rnti`, `frame`, `antenna`, `port` (where the gNB says them) and one buffer: symbols x FFT size pairs
        of int16, in the order of the FFT. Symbols are averaged.
    symbols
        How many there are in the buffer.

    Raises
    ------
    CodecError
        `arguments` if one is missing, `buffer` if its length fits no FFT.
    """
    buffers = [value for value in values.values() if isinstance(value, bytes)]
    numbers = {name: value for name, value in values.items() if isinstance(value, int)}
    if not buffers or not {"rnti", "frame"} <= set(numbers):
        raise CodecError("arguments", "an estimate needs rnti, frame and a buffer")
    raw = buffers[-1]
    if not raw or len(raw) % (4 * symbols):
        raise CodecError("buffer", f"{len(raw)} bytes are not {symbols} symbols of 4 bytes a tone")
    pairs = np.frombuffer(raw, "<i2").astype(np.float32).reshape(symbols, -1, 2)
    mean = pairs.mean(axis=0)
    tones = np.fft.fftshift(mean[:, 0] + 1j * mean[:, 1]).astype(np.complex64)
    antenna = numbers.get("antenna", numbers.get("ant", 0))
    return Estimate(numbers["rnti"], numbers["frame"], antenna, numbers.get("port", 0), tones)


def used(tones: NDArray[np.complex64], step: int, count: int) -> NDArray[np.complex64]:
    """`count` tones, every `step`-th, around the middle of those that were sounded.

    Raises
    ------
    CodecError
        `silent` if nothing was sounded, `span` if the sounding is narrower than that.
    """
    sounded = np.flatnonzero(tones)
    if not len(sounded):
        raise CodecError("silent", "nothing was sounded")
    first, last = int(sounded[0]), int(sounded[-1])
    needed = (count - 1) * step + 1
    if last - first + 1 < needed:
        raise CodecError("span", f"{last - first + 1} tones were sounded, {needed} are needed")
    start = first + (last - first + 1 - needed) // 2
    return tones[start : start + needed : step]


@dataclass(slots=True)
class _Waiting:
    antennas: dict[int, NDArray[np.complex64]] = field(default_factory=dict)


class Soundings:
    """Estimates of single antennas in, whole soundings out.

    Parameters
    ----------
    antennas
        How many there are.
    rejected
        Where soundings that not all antennas gave are counted, as `incomplete`.
    """

    def __init__(self, antennas: int, rejected: Counters) -> None:
        self._antennas = antennas
        self._rejected = rejected
        self._waiting: dict[tuple[int, int], _Waiting] = {}

    def add(self, heard: Estimate, csi: NDArray[np.complex64]) -> NDArray[np.complex64] | None:
        """The sounding (antennas, tones) that the estimate completes, if it does.

        Raises
        ------
        CodecError
            `antenna` if there is no such antenna.
        """
        if not 0 <= heard.antenna < self._antennas:
            raise CodecError("antenna", f"antenna {heard.antenna} of {self._antennas}")
        key = heard.rnti, heard.frame
        waiting = self._waiting.get(key)
        if waiting is not None and heard.antenna in waiting.antennas:
            # Frame numbers come again every 10.24 s: an antenna that is there already begins a new sounding.
            self._rejected.add("incomplete")
            del self._waiting[key]
            waiting = None
        if waiting is None:
            waiting = self._waiting[key] = _Waiting()
            if len(self._waiting) > KEPT_SOUNDINGS:
                del self._waiting[next(iter(self._waiting))]
                self._rejected.add("incomplete")
        waiting.antennas[heard.antenna] = csi
        if len(waiting.antennas) < self._antennas:
            return None
        del self._waiting[key]
        return np.stack([waiting.antennas[n] for n in sorted(waiting.antennas)])


def tone_step(wanted_hz: float, spacing_hz: float) -> int | None:
    """Every how many-th tone of the gNB the array's tones are; None where it does not come out even."""
    step = round(wanted_hz / spacing_hz)
    return step if step >= 1 and math.isclose(step * spacing_hz, wanted_hz, rel_tol=1e-6) else None
