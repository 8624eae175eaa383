"""Finding an array's calibration: frames of a UE at a known place in, order and responses out.

The model is `measured[m, k] = antenna[n] subcarrier[k] true[n, k]` with input m = order[n]; the true channel
of a UE in sight is a spherical wave. From one place alone, a swapped cable cannot be told from a phase error.
The ratio of two UEs can: the antennas' responses cancel, and what is left depends only on where each input's
antenna sits. So the order comes from as many UEs as there are, known places or not, and the responses from
the reference.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from chachart.node.data.calibration import Calibration
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.directions.axis import manifold_of
from chachart.node.estimation.symmetries import symmetries

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]

ITERATIONS = 30
ROUNDS = 5
FFT_FACTOR = 16
MIN_SPREAD_RAD = np.radians(10.0)
"""Phase errors are never taken to be smaller than this when one place has to do."""
SYMMETRY_MARGIN = 0.05
"""By so much more of the phasors' sum must a mirrored or turned array explain."""
SURE_DELAY = 6.0
"""Delays of single antennas are believed when one is so many deviations from the mean."""
LEAST_TONES = 4
"""Subcarriers that it takes to tell delays of single antennas."""
SILENT = 1e-6
"""A subcarrier with so much less power than the strongest one carries nothing."""
MARGIN = 5.0
"""Log likelihood by which a swap must then beat chance: wrong in 1 of 100 arrays of 32 with 30 deg errors."""


def spherical(array: ArrayGeometry, position: NDArray[Any]) -> Complex:
    """Spherical waves from world positions (P, 3): complex (P, N_R, N_S), amplitude 1 / distance."""
    offset = array.element_positions() - np.asarray(position, np.float64)[:, None, :]
    distance = np.linalg.norm(offset, axis=2)
    turns = distance[:, :, None] * (array.frequencies_hz / array.light_speed_m_s)
    waves: Complex = np.exp(-2j * np.pi * turns) / distance[:, :, None]
    return waves


def coherent_mean(frames: NDArray[Any]) -> Complex:
    """The channel (...) common to frames (F, ...) that may each have a phase of their own.

    The first right singular vector of the frames, by power iteration, at the frames' amplitude.
    """
    flat = frames.reshape(len(frames), -1).astype(np.complex128)
    mean = flat[np.argmax(np.linalg.norm(flat, axis=1))]
    for _ in range(ITERATIONS):
        phase = np.exp(-1j * np.angle(flat @ mean.conj()))
        mean = phase @ flat / len(flat)
    common: Complex = mean.reshape(frames.shape[1:])
    return common


def signatures(covariance: NDArray[Any]) -> Complex:
    """The phases (P, N) of the strongest eigenvectors of covariances (P, N, N), as unit phasors."""
    return _phasor(np.linalg.eigh(covariance)[1][..., -1])


def plane_waves(array: ArrayGeometry, phasors: Complex) -> Complex:
    """The plane wave (P, N) that fits each row of `phasors` (P, N) best; unit phasors."""
    if not array.is_uniform:
        manifold = manifold_of(replace(array, dead_antennas=()))
        x = phasors[:, :, None]
        return manifold.steering(manifold.extremum(manifold.features(x, x.conj()), maximum=True)[0])
    n = phasors.shape[1]
    size = FFT_FACTOR * n
    power = np.abs(np.fft.fft(phasors, size, axis=1)) ** 2
    u = 2 * np.pi * np.fft.fftfreq(size)
    power[:, np.abs(u) > array.theta_phase + np.pi / n] = 0.0
    peak = power.argmax(axis=1)
    rows = np.arange(len(phasors))
    left, top, right = (power[rows, (peak + step) % size] for step in (-1, 0, 1))
    bend = left - 2 * top + right
    shift = np.divide(0.5 * (left - right), bend, out=np.zeros_like(bend), where=bend < 0)
    fitted = u[peak] + np.clip(shift, -0.5, 0.5) * (2 * np.pi / size)
    waves: Complex = np.exp(1j * fitted[:, None] * np.arange(n))
    return waves


def templates(array: ArrayGeometry, phasors: Complex, position: NDArray[Any]) -> Complex:
    """What each row of `phasors` (P, N) should be: a spherical wave where the position (P, 3) is known (not
    NaN), else the plane wave that fits best; unit phasors (P, N)."""
    expected = plane_waves(array, phasors)
    known = np.isfinite(position).all(axis=1)
    if known.any():
        expected[known] = _phasor(spherical(array, position[known])[:, :, 0])
    return expected


def find_order(
    array: ArrayGeometry, phasors: Complex, reference: Complex, position: NDArray[Any]
) -> tuple[int, ...]:
    """For each element the input that it is connected to, from several UEs.

    Parameters
    ----------
    phasors
        (P, N_R): the channel of each UE at each input over that of the reference UE, as unit phasors.
    reference
        (N_R,): the true channel of the reference UE at each element.
    position
        (P, 3): where the UEs are, NaN where unknown.
    """
    start = _start(array, phasors, reference, position)
    order = _assigned(array, phasors[:, start], reference, position)
    return tuple(int(m) for m in start[order])


def _start(
    array: ArrayGeometry, phasors: Complex, reference: Complex, position: NDArray[Any]
) -> NDArray[np.intp]:
    """The order to begin with: as described, or as if the array were mirrored or turned.

    Such a mistake changes the order of nearly all antennas at once, which pairs cannot tell.
    """
    identity = np.arange(phasors.shape[1])
    best, most = identity, _coherence(array, phasors * reference, reference, position) + SYMMETRY_MARGIN
    for order in symmetries(array).values():
        found = _coherence(array, phasors[:, order] * reference, reference, position)
        if found > most:
            best, most = order, found
    return best


def _coherence(array: ArrayGeometry, channels: Complex, reference: Complex, position: NDArray[Any]) -> float:
    """How well `channels` (P, N) are the waves that they should be, 0 to 1."""
    phasors = _phasor(channels)
    expected = templates(array, phasors, position)
    return float(np.abs((phasors * expected.conj()).mean(axis=1)).mean())


def _assigned(
    array: ArrayGeometry, phasors: Complex, reference: Complex, position: NDArray[Any]
) -> NDArray[np.intp]:
    """The order that pairs of antennas speak for, beginning with none changed."""
    count, n = phasors.shape
    identity = np.arange(n)
    order = identity
    for _ in range(ROUNDS):
        # phasors[p, m] = true_p[n] / reference[n] with n the element at input m, once more in element order:
        channels = phasors[:, order] * reference
        ratio = templates(array, _phasor(channels), position) / reference
        phase = _phasor(np.sum(phasors[:, order] * ratio.conj(), axis=1, keepdims=True))
        score = ((phasors * phase.conj()).T @ ratio.conj()).real / count
        rows, inputs = linear_sum_assignment(-(score.T + 0.05 * np.eye(n)))
        found = _believable(score, inputs[np.argsort(rows)], count)
        if (found == order).all():
            break
        order = found
    return order


def suspect_order(phase_rad: Floats, swapped_phase_rad: Floats) -> tuple[int, ...]:
    """The likeliest order where frames of one place are all there is.

    Parameters
    ----------
    phase_rad
        (N_R,) phase error of each element if it is connected to its own input.
    swapped_phase_rad
        (N_R, N_R) phase error of element n if it is connected to input m, at [n, m].

    Two elements are taken to be swapped if that makes the phase errors of both small by comparison with those
    of all others: the gain in likelihood, for errors normal with the others' spread, must outweigh the number
    of pairs it was picked from.
    """
    n = len(phase_rad)
    order = np.arange(n)
    spread = max(MIN_SPREAD_RAD, 1.4826 * float(np.median(np.abs(phase_rad))))
    before = phase_rad**2
    after = swapped_phase_rad**2
    gain = (before[:, None] + before - after - after.T) / (2 * spread**2)
    gain[np.tril_indices(n)] = 0.0
    while gain.max() > np.log(n * n / 2) + MARGIN:
        i, j = np.unravel_index(gain.argmax(), gain.shape)
        order[[i, j]] = order[[j, i]]
        gain[[i, j], :] = gain[:, [i, j]] = 0.0
    return tuple(int(m) for m in order)


def responses(
    measured: Complex, expected: Complex, order: tuple[int, ...], offset_hz: Floats | None = None
) -> Calibration:
    """The calibration that makes `measured` (P, N_R, N_S) at the inputs into `expected` at the elements.

    The ratio of the two, up to a phase for each place, is fitted by an outer product of antennas and
    subcarriers, and by delays of single antennas where they stand out of the noise. The overall amplitude is
    left as it is. `offset_hz` (N_S,) are the subcarriers' distances from the carrier; None: no delays.
    Subcarriers that are `silent` are left as they are.
    """
    heard = ~silent(measured)
    ratio = coherent_mean((measured[:, list(order), :] / expected)[:, :, heard])
    offset_hz = None if offset_hz is None else offset_hz[heard]
    antenna, subcarrier = _product(ratio)
    delay_s = _delays(ratio, antenna, subcarrier, offset_hz)
    if delay_s is not None and offset_hz is not None:
        turn = np.exp(2j * np.pi * np.outer(delay_s, offset_hz))
        antenna, subcarrier = _product(ratio * turn)
    every = np.ones(len(heard), np.complex128)
    every[heard] = subcarrier
    return Calibration.of(order, antenna, every, delay_s)


def _product(ratio: Complex) -> tuple[Complex, Complex]:
    """Responses of antennas (N_R,) and subcarriers (N_S,) whose product is nearest to `ratio`."""
    left, size, right = np.linalg.svd(ratio)
    antenna, subcarrier = left[:, 0] * np.sqrt(size[0]), right[0] * np.sqrt(size[0])
    antenna = antenna / np.abs(antenna).mean() * np.exp(-1j * np.angle(antenna.sum()))
    subcarrier = subcarrier / np.abs(subcarrier).mean() * np.exp(-1j * np.angle(subcarrier[0]))
    return antenna, subcarrier


def _delays(ratio: Complex, antenna: Complex, subcarrier: Complex, offset_hz: Floats | None) -> Floats | None:
    """Delays (N_R,) about their mean of antennas that have some of their own; None if noise explains them."""
    s = ratio.shape[1]
    if s < LEAST_TONES or offset_hz is None:
        return None
    off = ratio / (antenna[:, None] * subcarrier)
    off = off / np.abs(off).mean()
    centred = offset_hz - offset_hz.mean()
    reach = np.pi / (np.diff(offset_hz).min() * 2)
    grid = np.linspace(-reach, reach, 8 * s + 1) / np.pi
    fit = np.abs(off @ np.exp(2j * np.pi * np.outer(centred, grid)))
    delay = grid[fit.argmax(axis=1)]
    for _ in range(3):
        rest = off * np.exp(2j * np.pi * np.outer(delay, centred))
        phase = np.angle(rest * np.exp(-1j * np.angle(rest.sum(axis=1, keepdims=True))))
        slope = (phase * centred).sum(axis=1) / (centred @ centred)
        delay = delay - slope / (2 * np.pi)
    left = np.angle(rest * np.exp(-1j * np.angle(rest.sum(axis=1, keepdims=True))))
    error = np.sqrt(float(np.mean(left**2)) / float(centred @ centred)) / (2 * np.pi)
    return delay - delay.mean() if np.abs(delay - delay.mean()).max() > SURE_DELAY * error else None


def silent(measured: NDArray[Any]) -> NDArray[np.bool_]:
    """Which subcarriers of frames (P, N_R, N_S) carry nothing, as guard bands and the carrier itself do."""
    power = np.einsum("pnk,pnk->k", measured, measured.conj()).real
    quiet: NDArray[np.bool_] = power <= SILENT * power.max()
    return quiet


def deviations(array: ArrayGeometry, phasors: Complex, position: NDArray[Any]) -> Floats:
    """How far each antenna is from the wave that the others see: rms phase (N_R,) in rad over P UEs.

    `phasors` is (P, N_R); the wave is spherical where the position (P, 3) is known, else the best plane wave.
    """
    off = phasors * templates(array, phasors, position).conj()
    off = off * _phasor(off.sum(axis=1, keepdims=True)).conj()
    rms: Floats = np.sqrt((np.angle(off) ** 2).mean(axis=0))
    return rms


def cycles(order: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The antennas that `order` moves, as cycles; a swap is a cycle of two."""
    found, seen = [], set()
    for start in range(len(order)):
        cycle = []
        n = start
        while n not in seen:
            seen.add(n)
            cycle.append(n)
            n = order[n]
        if len(cycle) > 1:
            found.append(tuple(cycle))
    return found


def _believable(score: Floats, order: NDArray[Any], count: int) -> NDArray[Any]:
    """`order` without the cycles that fit hardly better than no change would; `score` is [input, element]."""
    needed = 0.1 + 0.6 / np.sqrt(count)
    result = order.copy()
    for cycle in cycles(tuple(order)):
        here = np.array(cycle)
        if (score[order[here], here] - score[here, here]).mean() < needed:
            result[here] = here
    return result


def _phasor(values: Complex) -> Complex:
    size = np.abs(values)
    phasors: Complex = np.divide(values, size, out=np.ones_like(values, np.complex128), where=size > 0)
    return phasors
