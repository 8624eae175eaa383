"""The few strongest paths of a channel, by cancelling what is known and refitting it.

Newtonised orthogonal matching pursuit (Mamandipoor, Ramasamy and Madhow 2016): the strongest path of what is
left is refined by Newton steps, cancelled, and then every path in turn is refined in the channel without the
others, so that even two paths within a resolution cell come apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.estimation.directions.spectrum import AngleDelaySpectrum, Csi

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROUNDS = 2
"""How often all paths are refitted after each new one."""
STEPS = 4


@dataclass(slots=True, eq=False)
class Paths:
    """L paths of U UEs.

    Attributes
    ----------
    direction
        (U, L, 3).
    v
        (U, L): phase step between tones.
    amplitude
        complex (U, L), per element and tone; v counts from the middle tone in it.
    """

    direction: Floats
    v: Floats
    amplitude: Complex

    @property
    def power(self) -> Floats:
        """(U, L): per element and tone."""
        return np.abs(self.amplitude) ** 2


def pursue(
    model: AngleDelaySpectrum, frames: Csi, d: Floats, v: Floats, count: int, allowed: NDArray[np.bool_]
) -> Paths:
    """The path at d (U, 3), v (U,) and the strongest others of frames (U, N_R, N_S), `count` in all.

    `allowed` (D,) says which delays of the grid are looked at.
    """
    found = Paths(d[:, None].copy(), v[:, None].copy(), np.zeros((len(d), 1), np.complex128))
    refit(model, frames, found, [0])
    for number in range(1, count):
        left = (frames - waves(model, found)).astype(np.complex64)
        d, v = _strongest(model, left, allowed)
        found = Paths(
            np.concatenate([found.direction, d[:, None]], axis=1),
            np.concatenate([found.v, v[:, None]], axis=1),
            np.concatenate([found.amplitude, np.zeros((len(d), 1))], axis=1),
        )
        refit(model, frames, found, [number])
        for _ in range(ROUNDS):
            refit(model, frames, found, list(range(number + 1)))
    return found


def refit(model: AngleDelaySpectrum, frames: Csi, paths: Paths, numbers: list[int]) -> None:
    """Refine the numbered paths, each in the channel without the others, in place."""
    whole = waves(model, paths)
    for number in numbers:
        own = waves(model, paths, number)
        alone = (frames - (whole - own)).astype(np.complex64)
        d, v, _ = model.refine(alone, paths.direction[:, number], paths.v[:, number], STEPS)
        a = model.manifold.steering(d)
        y = model.moments(alone, v)[:, :, 0]
        paths.direction[:, number], paths.v[:, number] = d, v
        paths.amplitude[:, number] = (a.conj() * y).sum(axis=1) / (a.shape[1] * model.tones.size)
        whole += waves(model, paths, number) - own


def waves(model: AngleDelaySpectrum, paths: Paths, number: int | None = None) -> Complex:
    """The channel (U, N_R, N_S) of all paths, or of one."""
    which = slice(None) if number is None else slice(number, number + 1)
    a = model.manifold.steering(paths.direction[:, which]) * paths.amplitude[:, which, None]
    b = np.exp(-1j * paths.v[:, which, None] * model.tones.centred)
    channel: Complex = np.matmul(a.swapaxes(1, 2), b)
    return channel


def _strongest(model: AngleDelaySpectrum, frames: Csi, allowed: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Grid direction (U, 3) and delay (U,) of the largest point of each frame's spectrum."""
    best = []
    for start in range(0, len(frames), model.chunk):
        power = model.of(frames[start : start + model.chunk])
        power *= allowed
        best.append(power.reshape(len(power), -1).argmax(axis=1))
    i, j = np.divmod(np.concatenate(best), model.delays)
    return model.points[i], 2 * np.pi / model.delays * j
