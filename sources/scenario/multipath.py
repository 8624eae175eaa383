"""Multipath channels QLOS and QNLOS: a compact stochastic model of an urban macro cell.

Its equations and numbers follow QuaDRiGa's BERLIN_UMa_LOS and BERLIN_UMa_NLOS, with one omnidirectional
vertical antenna at each end.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.scenario.clusters import (
    OFFSETS,
    SUB_PATHS,
    Clusters,
    Draws,
    frame,
    scale,
    unit_vectors,
)
from chachart.sources.scenario.large_scale import LargeScaleFields, Statistics
from chachart.sources.scenario.phasor import over_tones, phasor, progression

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex64]

_MULTIPATH_STREAM = 5
MAX_UES = 50_000
"""A UE's sub-paths take about 7 KiB."""


class MultipathChannel:
    """Direct spherical wave plus clusters of 20 plane waves each.

    Modelled: eight correlated large-scale fields over the plane; the direct path at the exact geometry;
    clusters with exponential delays, and angles scaled to the fields; sub-paths as plane waves at the array,
    each cluster's power exact on each antenna, its delay running along the array.

    Moving UEs: the channel is a function of the UE and its position. The fields are met where the UE is, so
    gain and spreads change smoothly, and with them powers, delays and departure angles. The phase of each
    sub-path advances with the way that the UE goes towards where the sub-path arrived from at its start, so
    that frames near each other are coherent and the Doppler spectrum is that of the arrival angles.

    Not modelled: clusters that come and go on long ways (a UE keeps its own), clusters that neighbours share,
    antenna patterns, polarisation but for the power it takes, carrier phase from the change of a cluster's
    delay.

    Parameters
    ----------
    statistics
        `QLOS` or `QNLOS`.
    array
        The array that receives.
    start
        (U, 3) world positions of the UEs at time 0.
    seed
        Same seed, same channels.

    Raises
    ------
    SetupError
        For more UEs than memory would hold.
    """

    def __init__(
        self, statistics: Statistics, array: ArrayGeometry, start: NDArray[Any], seed: int = 0
    ) -> None:
        if len(start) > MAX_UES:
            raise SetupError(f"multipath channels of {len(start)} UEs: at most {MAX_UES} fit in memory")
        rng = np.random.default_rng([seed, _MULTIPATH_STREAM, statistics.clusters])
        self.array = array
        self._statistics = statistics
        self._start = np.asarray(start, np.float64)
        self._elements = array.element_positions()
        self._centre = self._elements.mean(axis=0)
        # the directions in which the array extends, and its elements' places along them
        self._ways = np.array([array.axis]) if array.is_uniform else array.frame
        self._places = (self._elements - self._centre) @ self._ways.T
        self._fields = LargeScaleFields(statistics, rng)
        self._draws = Draws.draw(statistics, len(start), rng)
        away, distance = self._from_array(self._start)
        self._arrival = scale(self._draws, self._fields.at(self._start, distance)).angle[..., 1::2]
        self._arrival_frame = frame(-away)

    def csi(self, ue: NDArray[Any], position: NDArray[Any]) -> Complexes:
        """Channels complex64 (K, N_R, N_S) of the UEs `ue` (indices, K) at world positions (K, 3)."""
        position = np.asarray(position, np.float64)
        draws = self._draws.take(ue)
        away, distance = self._from_array(position)
        large = self._fields.at(position, distance)
        clusters = scale(draws, large)
        waves, ahead = self._clusters_at_array(ue, position, away, draws, clusters, large.cross_polar)
        out = self._direct(position, clusters.direct)
        metres = distance[:, None] + self.array.light_speed_m_s * clusters.delay_s
        for c in range(metres.shape[1]):
            out += self._over_tones(waves[:, :, c], metres[:, c] - ahead[:, :, c])
        out *= np.sqrt(large.gain).astype(np.float32)
        return np.ascontiguousarray(out.transpose(2, 1, 0))

    def _from_array(self, position: Floats) -> tuple[Floats, Floats]:
        """Unit vectors (K, 3) from the array's centre to positions, and the distances (K,), at least 1 m."""
        offset = position - self._centre
        distance = np.linalg.norm(offset, axis=1)
        distance = np.maximum(distance, 1.0)
        return offset / distance[:, None], distance

    def _direct(self, position: Floats, power: Floats) -> Complexes:
        """The direct path (N_S, N_R, K): a spherical wave of the same power on all antennas."""
        distance = np.linalg.norm(position - self._elements[:, None], axis=2)
        first = phasor(-distance / self.array.wavelength_m) * np.sqrt(power).astype(np.float32)
        return self._over_tones(first, distance)

    def _over_tones(self, first: Complexes, path: Floats) -> Complexes:
        """Waves (N_S, ...) that have gone `path` metres (...), from what they are at the carrier."""
        return over_tones(first, path * (self.array.rho_phase / (2 * np.pi)), self.array.tone_numbers)

    def _clusters_at_array(
        self,
        ue: NDArray[Any],
        position: Floats,
        away: Floats,
        draws: Draws,
        clusters: Clusters,
        cross_polar: Floats,
    ) -> tuple[Complexes, Floats]:
        """Amplitudes (N_R, K, L) of the clusters on each antenna, and how many metres nearer each is, on
        average over the sub-paths, than the array's middle."""
        spread = np.deg2rad(self._statistics.cluster_spread_deg)
        own = np.einsum("kij,nj->kin", frame(away), self._ways).astype(np.float32)[:, :, None]
        phase = draws.phase + self._travelled(ue, position, draws, spread)
        ratio = cross_polar[:, None, None] * 10 ** (0.1 * draws.gain_db)
        gain = (ratio / (1 + ratio)).astype(np.float32)
        total = np.zeros((self.array.antennas, *clusters.power.shape), np.complex64)
        mean = np.zeros((*clusters.power.shape, len(self._ways)))
        for m in range(SUB_PATHS):
            azimuth = clusters.angle[..., 0] + spread[0] * OFFSETS[draws.order[0, ..., m]]
            elevation = clusters.angle[..., 2] + spread[2] * OFFSETS[draws.order[2, ..., m]]
            x, y, z = unit_vectors(azimuth.astype(np.float32), elevation.astype(np.float32))
            x, y, z = x[..., None], y[..., None], z[..., None]
            towards = (x * own[:, 0] + y * own[:, 1] + z * own[:, 2]).astype(np.float64)
            mean += towards / SUB_PATHS
            first = np.sqrt(gain[..., m]) * phasor(-phase[..., m])
            total += self._over_elements(first, towards)
        amplitude = np.sqrt(clusters.power * gain.mean(axis=-1)).astype(np.float32)
        size = np.maximum(np.abs(total), np.finfo(np.float32).tiny)
        total *= amplitude / size
        return total, np.moveaxis(mean @ self._places.T, -1, 0)

    def _over_elements(self, first: Complexes, towards: Floats) -> Complexes:
        """Plane waves (N_R, K, L), `first` at element 0, with cosines (K, L, W) to `_ways`."""
        if self.array.is_uniform:
            step = self.array.element_spacing_m / self.array.wavelength_m
            return progression(first, step * towards[..., 0], self.array.antennas)
        steps = (self._places - self._places[0]) / self.array.wavelength_m
        cycles = np.moveaxis(towards @ steps.T, -1, 0)
        return first * phasor(cycles)

    def _travelled(self, ue: NDArray[Any], position: Floats, draws: Draws, spread: Floats) -> NDArray[Any]:
        """Phase delay in cycles (K, L, M), or 0, of the sub-paths for the way from the UEs' starts."""
        way = position - self._start[ue]
        if not way.any():
            return np.zeros(1)
        local = np.einsum("kij,kj->ki", self._arrival_frame[ue], way).astype(np.float32)[:, :, None, None]
        angle = self._arrival[ue]
        azimuth = angle[..., 0, None] + spread[1] * OFFSETS[draws.order[1]]
        elevation = angle[..., 1, None] + spread[3] * OFFSETS[draws.order[3]]
        x, y, z = unit_vectors(azimuth.astype(np.float32), elevation.astype(np.float32))
        towards: NDArray[Any] = x * local[:, 0] + y * local[:, 1] + z * local[:, 2]
        return -towards / np.float64(self.array.wavelength_m)
