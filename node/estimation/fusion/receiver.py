"""An array as it is described, as fusion wants it: what counts of it, on evenly spaced tones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.site import Site

Complex = NDArray[np.complex64]

LEAST_ENERGY, MOST_ENERGY = 1e-28, 1e28
MOST_TONES = 4096
"""An even grid under the tones is not made longer than this."""


class Receiver:
    """An array's `Site`, and its frames without what does not count.

    Tones with gaps lie on an even grid with zeros in between, which add nothing to a matched filter.

    Raises
    ------
    ValueError
        If fewer than two tones count, or they are too far from even; the message begins with the name.
    """

    def __init__(self, array: ArrayGeometry) -> None:
        self.array = array
        self._correct = None if array.calibration is None else array.calibration.corrector(array.offsets_hz)
        self._antennas = np.flatnonzero(array.live_antennas)
        self._tones = np.flatnonzero(array.live_tones)
        numbers = array.tone_numbers[self._tones]
        if len(numbers) < 2:
            raise ValueError(f"array {array.name}: fusion needs at least two tones that count")
        step = int(np.gcd.reduce(np.diff(numbers)))
        self._places = (numbers - numbers[0]) // step
        self.tones = int(self._places[-1]) + 1
        if self.tones > MOST_TONES:
            raise ValueError(
                f"array {array.name}: tones from {numbers[0]} to {numbers[-1]} by {step} are too many"
            )
        spacing = step * array.subcarrier_spacing_hz
        first = float(array.frequencies_hz[self._tones[0]])
        facing = array.facing
        normal = None if facing is None else np.asarray(facing @ array.frame, np.float64)
        if array.is_line and array.sees is None:
            normal = array.normal
        self.site = Site(
            array.name,
            array.element_positions()[self._antennas],
            normal,
            np.asarray(first + spacing * np.arange(self.tones), np.float64),
            array.light_speed_m_s,
            measured=len(numbers),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Antennas and tones of prepared frames."""
        return len(self._antennas), self.tones

    def prepared(self, csi: Complex) -> Complex:
        """Frames (K, N_R, N_S) as (K, *shape)."""
        if self._correct is not None:
            csi = self._correct(csi)
        if len(self._antennas) < csi.shape[1] or len(self._tones) < csi.shape[2]:
            csi = csi[:, self._antennas[:, None], self._tones]
        if self.tones == csi.shape[2]:
            return np.ascontiguousarray(csi, np.complex64)
        even = np.zeros((len(csi), *self.shape), np.complex64)
        even[:, :, self._places] = csi
        return even


def usable(block: CsiBlock, rejected: Counters) -> CsiBlock | None:
    """The frames that hold something; others are counted, as `zero`, `not_finite` or `out_of_range`."""
    flat = block.csi.reshape(len(block), -1)
    with np.errstate(all="ignore"):
        energy = np.einsum("ki,ki->k", flat.real, flat.real) + np.einsum("ki,ki->k", flat.imag, flat.imag)
    good = (energy > LEAST_ENERGY) & (energy < MOST_ENERGY)
    if good.all():
        return block
    for reason, which in (
        ("zero", energy == 0),
        ("not_finite", ~np.isfinite(energy)),
        ("out_of_range", np.isfinite(energy) & (energy != 0) & ~good),
    ):
        if which.any():
            rejected.add(reason, int(which.sum()))
    return block.take(good) if good.any() else None
