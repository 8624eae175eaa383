"""How each antenna and each subcarrier does: levels, and which of them look dead, weak or saturated.

What counts is the *coherent* level: the antenna's share of the dominant left singular vector of a frame
H (antennas x subcarriers). Noise alone has hardly any of it, so that an antenna whose cable is off is found
at 0 dB too, where its power is no lower than that of the others' noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry

MEMORY_FRAMES = 256.0
FEWEST_FRAMES = 48
"""With fewer, fading passes for a fault."""
FEWEST_UES = 3
DEAD_DB = -15.0
WEAK_DB = -7.0
FULL_SHARE = 0.02
"""Of samples at an antenna's own highest value: a converter at its limit gives the same number often."""
_LEAST = 1e-30


class AntennaWatch:
    """Running means over frames of all UEs, as they come in: nothing is calibrated yet."""

    def __init__(self, array: ArrayGeometry) -> None:
        self._array = array
        self._frames = 0.0
        self._ues: set[int] = set()
        self._power = np.zeros(array.antennas)
        self._coherent = np.zeros(array.antennas)
        self._full = np.zeros(array.antennas)
        self._tones = np.zeros(array.subcarriers)

    def look(self, block: CsiBlock, frames: int = 16) -> None:
        """Take in at most so many frames of the block."""
        pick = np.unique(np.linspace(0, len(block) - 1, frames).round().astype(np.intp))
        csi = block.csi[pick]
        power = np.abs(csi) ** 2
        level = power.mean(axis=(1, 2))
        usable = np.isfinite(level) & (level > 0)
        if not usable.any():
            return
        level = level[usable, None, None]
        csi, power = csi[usable] / np.sqrt(level), power[usable] / level
        if len(self._ues) < FEWEST_UES:
            self._ues.update(block.ue[pick].tolist())
        keep = max(1 - len(csi) / MEMORY_FRAMES, 0.0)
        self._frames = keep * self._frames + len(csi)
        for name, news in (
            ("_power", power.mean(axis=2)),
            ("_tones", power.mean(axis=1)),
            ("_coherent", _coherent(csi)),
            ("_full", _at_the_limit(csi)),
        ):
            setattr(self, name, keep * getattr(self, name) + news.sum(axis=0))

    def report(self) -> dict[str, Any]:
        """Levels in dB against the median, and the faults by antenna's number; {} before the first frame.

        `power_db` and `coherent_db` have a number an antenna, `tone_db` one a subcarrier; `faults` says
        `dead`, `weak` or `saturated` of those antennas that the array does not already leave out.
        """
        if not self._frames:
            return {}
        coherent = _decibels(self._coherent)
        return {
            "power_db": _decibels(self._power).tolist(),
            "coherent_db": coherent.tolist(),
            "tone_db": _decibels(self._tones).tolist(),
            "frames": round(self._frames),
            "faults": self._faults(coherent),
        }

    def _faults(self, coherent: NDArray[np.float64]) -> dict[str, str]:
        if self._frames < FEWEST_FRAMES:
            return {}
        faults: dict[str, str] = {}
        for n in np.flatnonzero(self._array.live_antennas).tolist():
            if coherent[n] < DEAD_DB:
                faults[str(n)] = "dead"
            elif self._full[n] / self._frames > FULL_SHARE:
                faults[str(n)] = "saturated"
            elif coherent[n] < WEAK_DB and len(self._ues) >= FEWEST_UES:
                faults[str(n)] = "weak"
        return faults


def response(csi: NDArray[np.complex64]) -> dict[str, Any]:
    """Level and phase of one frame (antennas, subcarriers) by antenna and by subcarrier, as plain lists.

    `antenna_db`, `antenna_phase` are those of the dominant left singular vector, `tone_db`, `tone_phase` of
    the right one: dB against the median, and radians against the strongest.
    """
    left, _, right = np.linalg.svd(np.nan_to_num(csi), full_matrices=False)
    found: dict[str, Any] = {}
    for name, vector in (("antenna", left[:, 0]), ("tone", right[0])):
        strongest = vector[np.argmax(np.abs(vector))]
        phase = np.angle(vector * np.conj(strongest))
        found[f"{name}_db"] = _decibels(np.abs(vector.astype(np.complex128)) ** 2).tolist()
        found[f"{name}_phase"] = phase.astype(np.float64).round(4).tolist()
    return found


def _coherent(csi: NDArray[np.complex64]) -> NDArray[np.float64]:
    """|u|^2 of the dominant left singular vector u of each frame H, by that of H H^H (K, antennas)."""
    _, left = np.linalg.eigh(csi @ csi.conj().swapaxes(1, 2))
    power: NDArray[np.float64] = np.abs(left[:, :, -1]).astype(np.float64) ** 2
    return power


def _at_the_limit(csi: NDArray[np.complex64]) -> NDArray[np.float64]:
    """Which share of each antenna's I and Q samples is at its own highest value (K, antennas).

    One sample is there always, and counts for nothing.
    """
    parts = np.maximum(np.abs(csi.real), np.abs(csi.imag))
    full = parts >= 0.999 * parts.max(axis=2, keepdims=True)
    share: NDArray[np.float64] = (full.sum(axis=2) - 1) / csi.shape[2]
    return share


def _decibels(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Against the median, to a hundredth; at least -60."""
    positive = np.maximum(values, _LEAST)
    against: NDArray[np.float64] = 10 * np.log10(positive / max(np.median(positive), _LEAST))
    return np.maximum(against, -60.0).round(2)
