"""The few strongest paths of frames, one after the other: found, fitted together, cancelled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.columns import COLUMNS
from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.path_list import FAR_M, NEAREST_M, PATHS, PathList
from chachart.node.estimation.fusion.receiver import usable
from chachart.node.estimation.fusion.site import Complex, Floats
from chachart.node.estimation.fusion.strongest import CHUNK, Pathfinder


class PathLists:
    """Finds the `PATHS` strongest paths of an array's frames (CLEAN, with all amplitudes fitted anew).

    Raises
    ------
    ValueError
        If the array is none that can be fused; the message begins with its name.
    """

    def __init__(self, array: ArrayGeometry) -> None:
        self._finder = Pathfinder(array)
        site = self._finder.site
        self._geometry = (site.elements, site.tones_hz, array.carrier_hz, site.light_speed_m_s)

    def told(self, update: ChartUpdate, block: CsiBlock) -> ChartUpdate:
        """The rows with the paths of the newest frame of each UE."""
        good = usable(block, Counters()) if len(update) else None
        if good is None:
            return update
        block = good
        order = np.lexsort((block.time_ns, block.ue))
        last = order[np.append(block.ue[order][1:] != block.ue[order][:-1], True)]
        there = np.flatnonzero(np.isin(update.ue, block.ue))
        newest = last[np.searchsorted(block.ue[last], update.ue[there])]
        known = (update["relative"] == 0) & np.isfinite(update.rho)
        far = np.where(known, np.maximum(update.rho, NEAREST_M), FAR_M)
        paths = COLUMNS["paths"].missing(len(update))
        paths[there] = self.of(block.csi[newest], far[there]).packed()
        return update.with_columns(paths=paths)

    def of(self, csi: Complex, far_m: Floats) -> PathList:
        """Of frames (K, N_R, N_S) as they come, of UEs about `far_m` (K,) away."""
        parts = [
            self._of(self._finder.prepared(csi[i : i + CHUNK]), far_m[i : i + CHUNK])
            for i in range(0, len(csi), CHUNK)
        ]
        level, direction, length, amplitude = (
            np.concatenate(columns) for columns in zip(*parts, strict=True)
        )
        return PathList(level, direction, length, amplitude)

    def _of(self, frames: Complex, far_m: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.complex128]]:
        """Level, directions, lengths and amplitudes."""
        measured = (frames != 0).any(axis=(0, 1))
        count = len(frames)
        power = np.asarray(np.mean(np.abs(frames[:, :, measured]) ** 2, axis=(1, 2)), np.float64)
        direction = np.zeros((count, PATHS, 3))
        length = np.zeros((count, PATHS))
        left = frames
        for n in range(PATHS):
            one = self._finder.strongest(left, far_m)
            direction[:, n], length[:, n] = one.direction, one.length_m
            found = PathList(
                power, direction[:, : n + 1], length[:, : n + 1], np.zeros((count, n + 1), complex)
            )
            waves = found.waves(self._geometry[0], far_m, *self._geometry[1:])
            waves[..., ~measured] = 0
            flat = waves.reshape(count, n + 1, -1)
            gram = flat.conj() @ flat.swapaxes(1, 2)
            gram += 1e-6 * flat.shape[2] * np.eye(n + 1)
            amplitude = np.linalg.solve(gram, flat.conj() @ frames.reshape(count, -1, 1))
            explained = np.einsum("kp,kpns->kns", amplitude[..., 0], waves)
            left = np.asarray(frames - explained, np.complex64)
        return 10 * np.log10(power), direction, length, amplitude[..., 0] / np.sqrt(power)[:, None]
